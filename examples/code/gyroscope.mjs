// The game loop of gyroscope.c in JavaScript.
//
//     kreisel code gyroscope.toml --method exact --name euler_top --language js > euler_top.mjs
//     node gyroscope.mjs
//
// In a page: the same two lines of imports in <script type="module">, and one step for each picture.
import { Body, NAMES } from "./euler_top.mjs";

const pictures = Number(process.argv[2] ?? 10_000_000);
const energy = NAMES.indexOf("energy");
const g = NAMES.indexOf("g[0]");
const body = new Body();
const first = body.observe()[energy];

function axis(q) { // the third axis of the body in space, from the quaternion (w, x, y, z)
    const [w, x, y, z] = q;
    return [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)];
}

for (let k = 1; k <= 5; k++) {
    body.advance(Math.floor(pictures / 5)); // in a game: one step a picture
    const out = body.observe();
    const a = axis(out.slice(g, g + 4)).map((v) => v.toFixed(3));
    const change = (out[energy] / first - 1).toExponential(1);
    console.log(`after ${k * Math.floor(pictures / 5)} steps: axis ${a.join(" ")}, energy changed by ${change}`);
}
const kicked = Array.from(body.observe());
kicked[0] += 0.01; // somebody kicks it: the motion goes on from there
body.begin(kicked);
body.advance(30);
console.log(`kicked: energy ${body.observe()[energy].toFixed(6)}, was ${first.toFixed(6)}`);
