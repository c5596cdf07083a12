@@ head
/*
@head@

@licence@

    import { Body } from "./@name@.mjs";
    const body = new Body();     // or of another state
    body.advance(1000);          // so many steps
    body.observe();              // state, Casimirs, integrals
*/

@@ helpers
const { abs, cos, exp, log, max, min, sin, sqrt } = Math;
const fma = (x, y, z) => x * y + z; // rounded twice: the language has no other
const sign = (x) => (x < 0 ? -1 : 1);
const size = abs;
const where_less = (x, y, yes, no) => (x < y ? yes : no);

function halves(x) { // x as the sum of two numbers of 26 digits (Dekker)
    const t = 134217729 * x;
    const high = t - (t - x);
    return [high, x - high];
}

function exact_fma(x, y, z) { // x y + z with the rounding error of x y
    const p = x * y;
    if (!(abs(p) < 1e290) || !(abs(x) < 1e290) || !(abs(y) < 1e290)) return p + z;
    const [a, b] = halves(x);
    const [c, d] = halves(y);
    const e = ((a * c - p) + a * d + b * c) + b * d;
    const s = p + z;
    const t = s - p;
    return s + (((p - (s - t)) + (z - t)) + e);
}

@@ projected
export class Body {
    constructor(x = START) {
        this.z = new Float64Array(@size@); // the method's own variables
        this.targets = new Float64Array(4 * @invariants@); // of the invariants
        this.worst = new Float64Array(@invariants@); // the largest corrections, in units of 2^-52 |z|
        this.bound = new Float64Array(4 * @bonds@ + 1); // of the orientation
        this.spare = new Float64Array(@bonds@ + 1);
        this.room = new Float64Array(@room@);
        this.begin(x);
    }

    begin(x) { // from another state: after a kick, say
        open_state(x, this.z);
        this.done = 0; // steps since the last projection
        for (const array of [this.targets, this.worst, this.bound, this.spare]) array.fill(0);
        this.project(1);
    }

    project(begin) {
        @calls@
    }

    advance(steps) {
        while (steps > 0) {
            const count = min(steps, @every@ - this.done);
            for (let i = 0; i < count; i++) step(this.z);
            steps -= count;
            this.done += count;
            if (this.done === @every@) {
                this.done = 0;
                this.project(0);
            }
        }
    }

@@ plain
export class Body {
    constructor(x = START) {
        this.z = new Float64Array(@size@); // the method's own variables
        this.begin(x);
    }

    begin(x) { // from another state: after a kick, say
        open_state(x, this.z);
    }

    advance(steps) {
        for (let i = 0; i < steps; i++) step(this.z);
    }

@@ back
    back(steps) {
        for (let i = 0; i < steps; i++) step_back(this.z);
    }

@@ end
    observe(out = new Float64Array(@outputs@)) {
        outputs(this.z, out);
        return out;
    }
}

export const NAMES = [@names@];
@@ call
(begin ? begin_projection_@k@ : project_@k@)(this.z, this.@targets@, this.@worst@, this.room);
@@ def map
function @function@(@source@, @target@) {
@@ def inplace
export function @function@(z) {
@@ def stage
@table@[stage][@j@]
@@ def project
function @function@(z, targets, worst, room) {
