"""MuJoCo with the rotation of a free joint by the file that `kreisel code` writes.

    kreisel code free-body --set I=1,2,2.5 --language python --name rock > rock.py
    python mujoco_free_joint.py

MuJoCo steps the translation, contacts and the other joints.  After each of its steps the rotation of the free body is
replaced: the momentum takes the impulse of MuJoCo's forces, and the file moves momentum and attitude.
"""

from __future__ import annotations

import mujoco
import rock

MOMENTS = (1.0, 2.0, 2.5)
MODEL = """<mujoco><option timestep="0.002" gravity="0 0 0"><flag autoreset="disable"/></option><worldbody><body>
<freejoint/><inertial pos="0 0 0" mass="1" diaginertia="1 2 2.5"/></body></worldbody></mujoco>"""


class FreeRotation:
    """The rotation of a free joint whose first places in qpos and qvel are `place` and `rate`."""

    def __init__(self, model, data, moments, place=3, rate=3):
        self.moments, self.place, self.rate = moments, place, rate
        status = rock.check(moments, model.opt.timestep)
        if status:
            raise ValueError(rock.message(status))
        self.constants, self.state = rock.Constants(), rock.State()
        rock.prepare(self.constants, moments, model.opt.timestep)
        self.read(data)

    def read(self, data):
        """Begin from the attitude and the angular velocity of MuJoCo: at the start, and after a reset."""
        self.state.g[:] = data.qpos[self.place : self.place + 4].tolist()
        self.state.M[:] = [i * w for i, w in zip(self.moments, data.qvel[self.rate : self.rate + 3], strict=True)]

    def step(self, model, data):
        """A step of MuJoCo, with this rotation."""
        mujoco.mj_step(model, data)
        torque = data.qfrc_applied[self.rate : self.rate + 3] + data.qfrc_constraint[self.rate : self.rate + 3]
        half = [0.5 * model.opt.timestep * x for x in torque]
        self.state.M[:] = [m + x for m, x in zip(self.state.M, half, strict=True)]
        rock.step(self.constants, self.state)
        self.state.M[:] = [m + x for m, x in zip(self.state.M, half, strict=True)]
        data.qpos[self.place : self.place + 4] = self.state.g
        data.qvel[self.rate : self.rate + 3] = [m / i for m, i in zip(self.state.M, self.moments, strict=True)]


if __name__ == "__main__":
    model = mujoco.MjModel.from_xml_string(MODEL)
    data = mujoco.MjData(model)
    data.qvel[3:] = (0.001, 3.0, 0.0)
    body = FreeRotation(model, data, MOMENTS)
    first = rock.energy(body.constants, body.state)
    for _ in range(50_000):
        body.step(model, data)
    last = rock.energy(body.constants, body.state)
    print(f"after {data.time:.0f} s the energy has changed by {last / first - 1:.0e}")
