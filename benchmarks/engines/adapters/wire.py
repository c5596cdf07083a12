"""The adapters' side of the protocol: a job as JSON on standard input, rows of CSV on standard output.

job    {case, mass, inertia (3 x 3, about the centre of mass), attitude (w, x, y, z; body to space), angular_velocity
       (body axes, rad/s), velocity (3) of the centre of mass, gravity (3) or null, arm (3) from the pivot to the centre
       of mass or null, dt, steps, every, setting, package}, in SI units
rows   time, qw, qx, qy, qz, wx, wy, wz: attitude body to space, angular velocity in rad/s along the body axes

It needs no package: each engine has a separate environment.
"""

import importlib.metadata
import json
import math
import os
import sys
import time


def to_body(q, v):
    """v (3) in space as seen along the axes of the body of attitude q."""
    norm = math.sqrt(sum(a * a for a in q))
    w, x, y, z = (a / norm for a in q)
    t = [2 * (v[1] * z - v[2] * y), 2 * (v[2] * x - v[0] * z), 2 * (v[0] * y - v[1] * x)]
    cross = [t[1] * z - t[2] * y, t[2] * x - t[0] * z, t[0] * y - t[1] * x]
    return [v[k] + w * t[k] + cross[k] for k in range(3)]


def about_pivot(job):
    """The inertia tensor (3, 3) about the pivot (Steiner); without a pivot about the centre of mass."""
    arm, mass = job["arm"] or [0.0] * 3, job["mass"]
    square = sum(a * a for a in arm)
    return [[job["inertia"][j][k] + mass * (square * (j == k) - arm[j] * arm[k]) for k in range(3)] for j in range(3)]


def serve(start, frame="space"):
    """start(job) returns advance(n), which makes n steps, and state(), the attitude and the angular velocity.

    frame    "space" or "body": the axes of that angular velocity
    """
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # Engines print to standard output.
    job = json.load(sys.stdin)
    advance, state = start(job)
    package = importlib.metadata.metadata(job["package"])
    out.write("# " + json.dumps({"version": package["Version"], "summary": package["Summary"]}) + "\n")
    out.write("time_s,qw,qx,qy,qz,wx_rad_s,wy_rad_s,wz_rad_s\n")
    seconds, step = 0.0, 0  # of processor time, which other work hardly changes
    while True:
        q, omega = ([float(a) for a in part] for part in state())
        omega = to_body(q, omega) if frame == "space" else omega
        out.write(",".join(repr(a) for a in (step * job["dt"], *q, *omega)) + "\n")
        if step >= job["steps"]:
            break
        begun = time.process_time()
        advance(job["every"])
        seconds += time.process_time() - begun
        step += job["every"]
    out.write("# " + json.dumps({"seconds": seconds}) + "\n")
    out.flush()
    os._exit(0)  # Some engines crash when the interpreter ends.
