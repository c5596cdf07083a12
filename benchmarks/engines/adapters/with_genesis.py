"""Genesis on the CPU, with a free joint or a ball joint.  Setting: precision and integrator."""

import tempfile

import genesis as gs
from wire import serve


def start(job):
    precision, integrator = job["setting"].split()
    gs.init(backend=gs.cpu, precision=precision, logging_level="error")
    moments = " ".join(repr(job["inertia"][k][k]) for k in range(3))
    arm = " ".join(repr(a) for a in job["arm"] or [0.0] * 3)
    joint = "ball" if job["arm"] else "free"
    options = gs.options.SimOptions(dt=job["dt"], substeps=1, gravity=tuple(job["gravity"] or [0.0] * 3))
    rigid = gs.options.RigidOptions(enable_collision=False, integrator=getattr(gs.integrator, integrator))
    scene = gs.Scene(sim_options=options, rigid_options=rigid, show_viewer=False)
    with tempfile.NamedTemporaryFile("w", suffix=".xml") as file:
        file.write(f"""
          <mujoco><worldbody><body name="body">
            <joint type="{joint}"/><inertial pos="{arm}" mass="{job["mass"]!r}" diaginertia="{moments}"/>
          </body></worldbody></mujoco>""")
        file.flush()
        body = scene.add_entity(gs.morphs.MJCF(file=file.name))
    scene.build()
    body.set_dofs_velocity([0.0] * (body.n_dofs - 3) + job["angular_velocity"])
    link = body.links[-1]

    def advance(n):
        for _ in range(n):
            scene.step()

    return advance, lambda: (link.get_quat().tolist(), link.get_ang().tolist())


serve(start)
