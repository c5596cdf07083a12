"""Spin and orientation for particles of a REBOUND simulation: the extra `rebound`.

    import rebound
    import kreisel as kr

    sim = rebound.Simulation()
    sim.add(m=1.0)
    sim.add(m=1.66e-7, a=0.387, e=0.206, name="Mercury")
    sim.integrator, sim.dt = "whfast", 0.01
    spins = kr.rebound.attach(sim, {"Mercury": kr.rebound.Body(inertia=(A, B, C), spin=(0, 0, w))})
    spins.integrate(1000.0)
    spins.spin("Mercury"), spins.angular_momentum(), spins.energy()
    spins.save("mercury.npz")                       # and kr.rebound.load

Lengths, times and masses are in the units of the simulation; vectors are in its frame.
"""

from __future__ import annotations

from kreisel.rebound.body import Body
from kreisel.rebound.spins import Spins, attach, load

__all__ = ["Body", "Spins", "attach", "load"]
