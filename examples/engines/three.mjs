// A spinning body in three.js: the mesh rotates by the file that `kreisel code` writes.
//
//     kreisel code free-body --set I=1,2,2.5 --language js --convention three --name rock > rock.mjs
//
// In a page: import { Spin } from "./three.mjs", const spin = new Spin(mesh, ...), spin.update(seconds) for each picture.
import * as rock from "./rock.mjs";

const DT = 1 / 240; // s; steps are independent of the pictures

export class Spin {
    // moments in kg m^2 along the axes of the mesh, angular velocity in rad/s
    constructor(mesh, moments, rate) {
        const status = rock.check(moments, DT);
        if (status) throw new RangeError(rock.message(status));
        this.mesh = mesh;
        this.constants = new rock.Constants();
        this.state = new rock.State();
        this.left = 0; // s that no step has covered
        rock.prepare(this.constants, moments, DT);
        for (let k = 0; k < 3; k++) this.state.M[k] = moments[k] * rate[k];
        mesh.quaternion.toArray(this.state.g);
    }

    // a blow: torque times time, N m s, along the axes of the mesh
    push(blow) {
        for (let k = 0; k < 3; k++) this.state.M[k] += blow[k];
    }

    update(seconds) {
        this.left += seconds;
        for (; this.left >= DT; this.left -= DT) rock.step(this.constants, this.state);
        this.mesh.quaternion.fromArray(this.state.g);
    }
}
