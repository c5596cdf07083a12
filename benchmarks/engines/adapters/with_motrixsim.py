"""MotrixSim: a body with a free joint, or a ball joint if there is a pivot; the model is written as MuJoCo's."""

import motrixsim
import numpy as np
from wire import serve


def start(job):
    moments = " ".join(repr(job["inertia"][k][k]) for k in range(3))
    arm = " ".join(repr(a) for a in job["arm"] or [0.0] * 3)
    gravity = " ".join(repr(a) for a in job["gravity"] or [0.0] * 3)
    joint = "ball" if job["arm"] else "free"
    model = motrixsim.load_mjcf_str(f"""
      <mujoco>
        <option timestep="{job["dt"]!r}" gravity="{gravity}"/>
        <worldbody><body name="body">
          <joint type="{joint}"/><inertial pos="{arm}" mass="{job["mass"]!r}" diaginertia="{moments}"/>
        </body></worldbody>
      </mujoco>""")
    data = motrixsim.SceneData(model)
    w, x, y, z = job["attitude"]
    position, velocity = np.array(data.dof_pos), np.array(data.dof_vel)
    position[-4:], velocity[-3:] = [x, y, z, w], job["angular_velocity"]
    data.set_dof_pos(position, model)
    data.set_dof_vel(velocity)
    model.forward_kinematic(data)

    def advance(n):
        for _ in range(n):
            model.step(data)

    def state():
        x, y, z, w = data.dof_pos[-4:]
        return (w, x, y, z), data.dof_vel[-3:]

    return advance, state


serve(start, frame="body")
