// The game loop of gyroscope.c in JavaScript.
//
//     kreisel code free-body --name rock --language js > rock.mjs
//     node gyroscope.mjs
//
// In a page: the same line of imports in <script type="module">, and one step for each picture.
import { Constants, State, advance, check, energy, message, prepare } from "./rock.mjs";

const pictures = Number(process.argv[2] ?? 10_000_000), moments = [5.5, 4.5, 3], dt = 1 / 30;
const c = new Constants(), s = new State(), status = check(moments, dt);
if (status) throw new Error(`expected: ${message(status)}`);
prepare(c, moments, dt);
s.M.set([0.02, 4.5, 0.01]);
s.g[0] = 1;
const first = energy(c, s);

for (let k = 1; k <= 5; k++) {
    advance(c, s, Math.floor(pictures / 5)); // in a game: one step a picture
    const [w, x, y, z] = s.g; // the third axis of the body in space
    const axis = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)].map((v) => v.toFixed(3));
    const change = (energy(c, s) / first - 1).toExponential(1);
    console.log(`after ${k * Math.floor(pictures / 5)} steps: axis ${axis.join(" ")}, energy changed by ${change}`);
}
s.M[0] += 0.01; // somebody kicks it: the motion goes on from there
advance(c, s, 30);
console.log(`kicked: energy ${energy(c, s).toFixed(6)}, was ${first.toFixed(6)}`);
