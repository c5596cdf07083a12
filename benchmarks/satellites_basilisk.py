"""A satellite in Basilisk: run by satellites_peers.py with the Python of an environment that has bsk.

Reads a job (JSON) from stdin and writes rows of quaternion, body rates and wheel momenta to stdout.  Basilisk has the
orbit, the hub, the gravity gradient, the field of a file of coefficients, the torque bars and the wheels; the sampled
laws are modules in Python, since Basilisk has neither B-dot nor hysteresis rods.
"""

import json
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from Basilisk.architecture import messaging, sysModel
from Basilisk.simulation import (
    GravityGradientEffector,
    MtbEffector,
    magneticFieldWMM,
    reactionWheelStateEffector,
    spacecraft,
)
from Basilisk.utilities import RigidBodyKinematics, SimulationBaseClass, macros, simIncludeGravBody, simIncludeRW
from satellite_laws import LAWS

WHEEL_MOMENT = 1e-6  # kg m^2, of each wheel about its axis
BARS = (np.eye(3)).ravel().tolist()


class Earth(sysModel.SysModel):
    """The rotation of the Earth as a message."""

    def __init__(self, angle, rate):
        super().__init__()
        self.angle, self.rate, self.out = angle, rate, messaging.SpicePlanetStateMsg()

    def UpdateState(self, now):
        """Write the message of now, ns."""
        data = messaging.SpicePlanetStateMsgPayload()
        data.J20002Pfix = RigidBodyKinematics.euler3(self.angle + self.rate * now * 1e-9).tolist()
        data.computeOrient = 1
        self.out.write(data, now, self.moduleID)


class Computer(sysModel.SysModel):
    """The sampled law: reads the state and the field, writes dipoles and torques of motors."""

    def __init__(self, job, craft, field, wheels):
        super().__init__()
        self.law, self.constant = LAWS[job["law"]](**job["parameters"]), np.array(job["moment"])
        self.craft, self.wheels = craft.scStateOutMsg, wheels
        self.field, self.bars, self.motors = field, messaging.MTBCmdMsg(), messaging.ArrayMotorTorqueMsg()

    def UpdateState(self, now):
        """Write the commands of a sample at now, ns."""
        state = self.craft.read()
        C = np.array(RigidBodyKinematics.MRP2C(state.sigma_BN)).T  # body to space
        rates, momenta = np.array(state.omega_BN_B), np.zeros(3)
        if self.wheels is not None:
            spins = np.array(self.wheels.rwSpeedOutMsg.read().wheelSpeeds[:3])
            momenta = WHEEL_MOMENT * (spins + rates)
        seen = {"B": C.T @ np.array(self.field.read().magField_N), "w": rates, "C": C, "h": momenta}
        dipole, motors = self.law(r=np.array(state.r_BN_N), v=np.array(state.v_BN_N), **seen)
        data = messaging.MTBCmdMsgPayload()
        data.mtbDipoleCmds = (dipole + self.constant).tolist()
        self.bars.write(data, now, self.moduleID)
        data = messaging.ArrayMotorTorqueMsgPayload()
        data.motorTorque = motors.tolist()
        self.motors.write(data, now, self.moduleID)


def bars(craft, field, commands):
    """Three magnetic torque bars along the body axes."""
    data = messaging.MTBArrayConfigMsgPayload()
    data.numMTB, data.GtMatrix_B, data.maxMtbDipoles = 3, BARS, [1e3] * 3
    effector = MtbEffector.MtbEffector()
    config = messaging.MTBArrayConfigMsg().write(data)
    effector.mtbParamsInMsg.subscribeTo(config)
    effector.mtbCmdInMsg.subscribeTo(commands)
    effector.magInMsg.subscribeTo(field)
    craft.addDynamicEffector(effector)
    return effector, config  # which Basilisk does not keep


def three_wheels(craft, rates):
    """Balanced wheels along the body axes, at rest in space."""
    factory = simIncludeRW.rwFactory()
    for axis, rate in zip(np.eye(3), rates, strict=True):
        factory.create("custom", axis, Omega=-rate * 30 / np.pi, Js=WHEEL_MOMENT, u_max=1e3, Omega_max=1e9)
    effector = reactionWheelStateEffector.ReactionWheelStateEffector()
    factory.addToSpacecraft("wheels", effector, craft)
    return effector


def main():
    job = json.load(sys.stdin)
    simulation = SimulationBaseClass.SimBaseClass()
    process = simulation.CreateNewProcess("process")
    dt = macros.sec2nano(job["dt"])
    process.addTask(simulation.CreateNewTask("task", dt))
    process.addTask(simulation.CreateNewTask("samples", macros.sec2nano(job["every"])), -1)
    craft = spacecraft.Spacecraft()
    craft.hub.mHub = job["mass"]
    turning = np.array(job["inertia"]) + (WHEEL_MOMENT * np.eye(3) if job["wheels"] else 0)
    craft.hub.IHubPntBc_B = turning.tolist()
    craft.hub.r_CN_NInit, craft.hub.v_CN_NInit = job["position"], job["velocity"]
    craft.hub.sigma_BNInit = [[a] for a in RigidBodyKinematics.EP2MRP(np.array(job["attitude"]))]
    craft.hub.omega_BN_BInit = [[a] for a in job["rates"]]
    earth = simIncludeGravBody.gravBodyFactory().createEarth()
    earth.isCentralBody, earth.mu = True, job["mu"]
    craft.gravField.gravBodies = spacecraft.GravBodyVector([earth])
    gradient = GravityGradientEffector.GravityGradientEffector()
    gradient.addPlanetName(earth.planetName)
    craft.addDynamicEffector(gradient)
    rotation = Earth(*job["meridian"])
    magnet = magneticFieldWMM.MagneticFieldWMM()
    folder = Path(tempfile.mkdtemp())
    (folder / "WMM.COF").write_text(job["coefficients"])
    magnet.configureWMMFile(str(folder / "WMM.COF"))
    magnet.epochDateFractionalYear = job["year"]
    magnet.planetPosInMsg.subscribeTo(rotation.out)
    magnet.addSpacecraftToModel(craft.scStateOutMsg)
    wheels = three_wheels(craft, job["rates"]) if job["wheels"] else None
    computer = Computer(job, craft, magnet.envOutMsgs[0], wheels)
    bar, _config = bars(craft, magnet.envOutMsgs[0], computer.bars)
    if wheels is not None:
        wheels.rwMotorCmdInMsg.subscribeTo(computer.motors)
    for module in (craft, gradient, bar, *([wheels] if wheels else []), rotation, magnet):
        simulation.AddModelToTask("task", module)
    simulation.AddModelToTask("samples", computer)
    log = craft.scStateOutMsg.recorder(macros.sec2nano(job["row"]))
    simulation.AddModelToTask("task", log)
    logs = [log]
    if wheels is not None:
        logs.append(wheels.rwSpeedOutMsg.recorder(macros.sec2nano(job["row"])))
        simulation.AddModelToTask("task", logs[1])
    simulation.InitializeSimulation()
    simulation.ConfigureStopTime(macros.sec2nano(job["end"]))
    begun = time.process_time()
    simulation.ExecuteSimulation()
    took = time.process_time() - begun
    quaternions = [np.array(RigidBodyKinematics.MRP2EP(s)).tolist() for s in log.sigma_BN]
    out = {"seconds": took, "times": (log.times() * 1e-9).tolist(), "attitude": quaternions}
    out |= {"rates": log.omega_BN_B.tolist(), "position": log.r_BN_N.tolist()}
    if wheels is not None:
        out["wheels"] = (WHEEL_MOMENT * (logs[1].wheelSpeeds[:, :3] + log.omega_BN_B)).tolist()
    print("\n" + json.dumps(out))


main()
