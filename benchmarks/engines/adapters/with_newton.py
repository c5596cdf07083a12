"""Newton on the CPU: a body with a free joint, or a ball joint if there is a pivot.  Setting: the solver.

Angular damping of SolverSemiImplicit and SolverFeatherstone, 0.05 by default, is off.
"""

import newton
import warp as wp
from wire import serve

DAMPED = ("SolverSemiImplicit", "SolverFeatherstone", "SolverXPBD")


def start(job):
    wp.set_device("cpu")
    builder = newton.ModelBuilder(gravity=wp.vec3(*(job["gravity"] or [0, 0, 0])))
    w, x, y, z = job["attitude"]
    arm = wp.vec3(*(job["arm"] or [0, 0, 0]))
    pose = wp.transform(wp.vec3(0.0, 0.0, 0.0), wp.quat(x, y, z, w))
    body = builder.add_link(
        xform=pose,
        com=arm,
        mass=job["mass"],
        inertia=wp.mat33(*(m for row in job["inertia"] for m in row)),
        lock_inertia=True,
    )
    joint = builder.add_joint_ball(-1, body) if job["arm"] else builder.add_joint_free(body)
    builder.add_articulation([joint])
    model = builder.finalize()
    name = job["setting"]
    solver = getattr(newton.solvers, name)(model, **({"angular_damping": 0.0} if name in DAMPED else {}))
    states = [model.state(), model.state()]
    control = model.control()
    # Velocities of a free joint are (linear, angular) in space, of a ball joint along the parent's axes.
    first = states[0]
    velocity = job["angular_velocity"] if job["arm"] else [0.0] * 3 + job["angular_velocity"]
    first.joint_qd.assign(velocity)
    newton.eval_fk(model, first.joint_q, first.joint_qd, first)

    def advance(n):
        for _ in range(n):
            states[0].clear_forces()
            solver.step(states[0], states[1], control, None, job["dt"])
            states.reverse()

    def state():
        x, y, z, w = states[0].body_q.numpy()[0][3:]
        return (w, x, y, z), states[0].body_qd.numpy()[0][3:]

    solver.step(states[0], states[1], control, None, job["dt"])  # compiles the kernels
    return advance, state


serve(start)
