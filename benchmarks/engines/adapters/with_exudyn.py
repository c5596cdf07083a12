"""EXUDYN: a rigid body, with a spherical joint to the ground if there is a pivot.

Setting: a solver of DynamicSolverType and a kind of nodes, "GeneralizedAlpha RotationEulerParameters", the defaults, or
"RK44 RotationRotationVector", explicit steps on the Lie group.
"""

import exudyn
import exudyn.utilities as utilities
import numpy as np
from wire import serve


def start(job):
    solver, nodes = job["setting"].split()
    container = exudyn.SystemContainer()
    mbs = container.AddSystem()
    mbs.CreateGround()
    body = mbs.CreateRigidBody(
        referencePosition=job["arm"] or [0, 0, 0],
        initialAngularVelocity=job["angular_velocity"],  # in space, where the body has its axes at the beginning
        initialVelocity=job["velocity"],
        inertia=utilities.RigidBodyInertia(job["mass"], np.array(job["inertia"])),
        gravity=job["gravity"] or [0, 0, 0],
        nodeType=getattr(exudyn.NodeType, nodes),
    )
    if job["arm"]:
        mbs.CreateSphericalJoint(bodyNumbers=[body, 0], position=[0, 0, 0], show=False)
    mbs.Assemble()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.verboseMode = 0
    settings.solutionSettings.writeSolutionToFile = False
    steps, variables = [0], exudyn.OutputVariableType

    def advance(n):
        times = settings.timeIntegration
        times.startTime = steps[0] * job["dt"]
        steps[0] += n
        times.endTime, times.numberOfSteps, times.automaticStepSize = steps[0] * job["dt"], n, False
        mbs.SolveDynamic(settings, solverType=getattr(exudyn.DynamicSolverType, solver), updateInitialValues=True)

    def state():
        turn = np.reshape(mbs.GetObjectOutputBody(body, variables.RotationMatrix, [0, 0, 0]), (3, 3))
        return utilities.RotationMatrix2EulerParameters(turn), mbs.GetObjectOutputBody(
            body, variables.AngularVelocityLocal, [0, 0, 0]
        )

    return advance, state


serve(start, frame="body")
