"""OpenSim on Simbody: a body with a free joint, or a ball joint if there is a pivot.  Setting: the integrator's steps.

"default" lets Manager's integrator, Runge-Kutta-Merson, choose its steps at its default accuracy; "1e-10" at that
accuracy; "fixed" makes steps of dt.
"""

import opensim as osim
from wire import serve


def start(job):
    model = osim.Model()
    model.setGravity(osim.Vec3(*(job["gravity"] or [0, 0, 0])))
    moments = [job["inertia"][k][k] for k in range(3)]
    arm = job["arm"] or [0, 0, 0]
    body = osim.Body("body", job["mass"], osim.Vec3(*arm), osim.Inertia(*moments, 0, 0, 0))
    model.addBody(body)
    kind = osim.BallJoint if job["arm"] else osim.FreeJoint
    joint = kind("joint", model.getGround(), body)
    model.addJoint(joint)
    state = model.initSystem()
    for k in range(3):
        joint.upd_coordinates(k).setSpeedValue(state, job["angular_velocity"][k])
    manager = osim.Manager(model)
    setting, steps = job["setting"], [0]
    if setting == "fixed":
        manager.setIntegratorFixedStepSize(job["dt"])
    elif setting != "default":
        manager.setIntegratorAccuracy(float(setting))
    manager.setPerformAnalyses(False), manager.setWriteToStorage(False)
    manager.setIntegratorInternalStepLimit(10**9)
    manager.initialize(state)
    now = [state]

    def advance(n):
        steps[0] += n
        now[0] = manager.integrate(steps[0] * job["dt"])

    def read():
        model.realizeVelocity(now[0])
        turn = body.getTransformInGround(now[0]).R().convertRotationToQuaternion()
        omega = body.getAngularVelocityInGround(now[0])
        return [turn.get(k) for k in range(4)], [omega.get(k) for k in range(3)]

    return advance, read


serve(start)
