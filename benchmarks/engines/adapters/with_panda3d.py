"""Panda3D's two engines: setting "Bullet", or "ODE", the Open Dynamics Engine; damping and sleeping off."""

from panda3d import bullet, core, ode
from wire import serve


def bullet_world(job, vector):
    world = bullet.BulletWorld()
    world.setGravity(vector(job["gravity"]))
    body = bullet.BulletRigidBodyNode("body")
    body.setMass(job["mass"])
    body.setInertia(core.LVecBase3f(*(job["inertia"][k][k] for k in range(3))))
    body.setLinearDamping(0), body.setAngularDamping(0), body.setDeactivationEnabled(False)
    path = core.NodePath("root").attachNewNode(body)
    path.setPos(*vector(job["arm"])), path.setQuat(core.Quat(*job["attitude"]))
    world.attach(body)
    body.setLinearVelocity(vector(job["velocity"])), body.setAngularVelocity(vector(job["angular_velocity"]))
    if job["arm"]:
        world.attach(bullet.BulletSphericalConstraint(body, core.Point3(*(-a for a in job["arm"]))))

    def advance(n):
        for _ in range(n):
            world.doPhysics(job["dt"], 0)

    return advance, lambda: (list(path.getQuat()), body.getAngularVelocity())


def ode_world(job, vector):
    world = ode.OdeWorld()
    world.setGravity(vector(job["gravity"]))
    body = ode.OdeBody(world)
    mass = ode.OdeMass()
    moments = [job["inertia"][k][k] for k in range(3)]
    mass.setParameters(job["mass"], 0, 0, 0, *moments, 0, 0, 0)
    body.setMass(mass), body.setAutoDisableFlag(False)
    body.setPosition(vector(job["arm"])), body.setQuaternion(core.Quat(*job["attitude"]))
    body.setLinearVel(vector(job["velocity"])), body.setAngularVel(vector(job["angular_velocity"]))
    joint = ode.OdeBallJoint(world)
    if job["arm"]:
        joint.attach(body, None), joint.setAnchor(0, 0, 0)

    def advance(n):
        for _ in range(n):
            world.step(job["dt"])

    return advance, lambda: (list(body.getQuaternion()), (joint and body).getAngularVel())


def start(job):
    make = bullet_world if job["setting"] == "Bullet" else ode_world
    return make(job, lambda v: core.LVecBase3f(*(v or [0, 0, 0])) and core.Vec3(*(v or [0, 0, 0])))


serve(start)
