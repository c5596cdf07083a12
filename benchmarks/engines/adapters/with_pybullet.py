"""PyBullet: a multibody without links; damping and sleeping off.

Setting "rigid" makes a btRigidBody of it (useMaximalCoordinates), with the gyroscopic term that Bullet has by default.
"""

import pybullet as p
from wire import serve


def start(job):
    p.connect(p.DIRECT)
    p.setGravity(*(job["gravity"] or [0, 0, 0]))
    p.setTimeStep(job["dt"])
    w, x, y, z = job["attitude"]
    shape = p.createCollisionShape(p.GEOM_SPHERE, radius=0.01)
    body = p.createMultiBody(
        baseMass=job["mass"],
        baseCollisionShapeIndex=shape,
        basePosition=job["arm"] or [0, 0, 0],
        baseOrientation=[x, y, z, w],
        useMaximalCoordinates=job["setting"] == "rigid",
    )
    moments = [job["inertia"][k][k] for k in range(3)]
    p.changeDynamics(body, -1, localInertiaDiagonal=moments, linearDamping=0, angularDamping=0, maxJointVelocity=1e6)
    p.changeDynamics(body, -1, activationState=p.ACTIVATION_STATE_DISABLE_SLEEPING)
    p.resetBaseVelocity(body, job["velocity"], job["angular_velocity"])
    if job["arm"]:
        pivot = [-a for a in job["arm"]]
        p.createConstraint(body, -1, -1, -1, p.JOINT_POINT2POINT, [0, 0, 0], pivot, [0, 0, 0])

    def advance(n):
        for _ in range(n):
            p.stepSimulation()

    def state():
        x, y, z, w = p.getBasePositionAndOrientation(body)[1]
        return (w, x, y, z), p.getBaseVelocity(body)[1]

    return advance, state


serve(start)
