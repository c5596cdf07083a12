"""Basilisk: a spacecraft's hub without gravity.  Setting: a class of svIntegrators."""

from Basilisk.simulation import spacecraft, svIntegrators
from Basilisk.utilities import RigidBodyKinematics, SimulationBaseClass, macros
from wire import serve


def start(job):
    simulation = SimulationBaseClass.SimBaseClass()
    step = macros.sec2nano(job["dt"])
    simulation.CreateNewProcess("process").addTask(simulation.CreateNewTask("task", step))
    craft = spacecraft.Spacecraft()
    craft.hub.mHub = job["mass"]
    craft.hub.IHubPntBc_B = job["inertia"]
    craft.hub.sigma_BNInit = [[a] for a in RigidBodyKinematics.EP2MRP(job["attitude"])]
    craft.hub.omega_BN_BInit = [[a] for a in job["angular_velocity"]]
    integrator = getattr(svIntegrators, job["setting"])(craft)
    craft.setIntegrator(integrator)
    simulation.AddModelToTask("task", craft)
    simulation.InitializeSimulation()
    simulation.ConfigureStopTime(0)
    simulation.ExecuteSimulation()
    steps = [0]

    def advance(n):
        steps[0] += n
        simulation.ConfigureStopTime(steps[0] * step)
        simulation.ExecuteSimulation()

    def state():
        message = craft.scStateOutMsg.read()
        return RigidBodyKinematics.MRP2EP(message.sigma_BN), message.omega_BN_B

    return advance, state


serve(start, frame="body")
