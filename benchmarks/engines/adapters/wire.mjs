// The adapters' side of the protocol: a job as JSON on standard input, rows of CSV on standard output.
//
// job    {case, mass, inertia (3 x 3, about the centre of mass), attitude (w, x, y, z; body to space), angular_velocity
//        (body axes, rad/s), velocity (3) of the centre of mass, gravity (3) or null, arm (3) from the pivot to the
//        centre of mass or null, dt, steps, every, setting, package}, in SI units
// rows   time, qw, qx, qy, qz, wx, wy, wz: attitude body to space, angular velocity in rad/s along the body axes
import { readFileSync, writeSync } from "node:fs";

// v (3) in space as seen along the axes of the body of attitude q.
export function toBody(q, v) {
  const [w, x, y, z] = q.map((a) => a / Math.hypot(...q));
  const t = [2 * (v[1] * z - v[2] * y), 2 * (v[2] * x - v[0] * z), 2 * (v[0] * y - v[1] * x)];
  return [v[0] + w * t[0] + t[1] * z - t[2] * y, v[1] + w * t[1] + t[2] * x - t[0] * z, v[2] + w * t[2] + t[0] * y - t[1] * x];
}

// start(job) returns {step, state}: step() makes one step, state() is [attitude, angular velocity in space].
export async function serve(start) {
  console.log = console.info = console.error; // Engines print to standard output.
  const job = JSON.parse(readFileSync(0, "utf8"));
  const { version, description: summary } = JSON.parse(readFileSync(`node_modules/${job.package}/package.json`, "utf8"));
  const { step, state } = await start(job);
  const rows = [`# ${JSON.stringify({ version, summary })}`, "time_s,qw,qx,qy,qz,wx_rad_s,wy_rad_s,wz_rad_s"];
  const row = (k) => {
    const [q, space] = state();
    rows.push([k * job.dt, ...q, ...toBody(q, space)].join(","));
  };
  row(0);
  const begun = process.cpuUsage(); // processor time, which other work hardly changes
  for (let k = 1; k <= job.steps; k++) {
    step();
    if (k % job.every === 0) row(k);
  }
  const { user, system } = process.cpuUsage(begun);
  rows.push(`# ${JSON.stringify({ seconds: (user + system) / 1e6 })}`);
  writeSync(1, rows.join("\n") + "\n");
  process.exit(0);
}
