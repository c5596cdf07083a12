"""A Moon on a tilted orbit: Sun, Earth and Moon in REBOUND, with spins and tides that lag.

The Sun makes the orbit of the Moon about the Earth, inclined by 60 degrees to its own, more eccentric and less inclined
by turns [von Zeipel, Lidov, Kozai].  Earth and Moon are flattened by their rotation, and each raises a late tide on the
other.  The angular momentum of orbits and spins together stays.  Needs the extra `rebound`; some seconds.
"""

import numpy as np
import rebound

import kreisel as kr
from kreisel.viewer.charts import figure

YEAR = 2 * np.pi  # G = 1, the mass of the Sun, au
DAY = YEAR / 365.25
EARTH, RADIUS = 3.003e-6, 4.2635e-5
MOON, MOON_RADIUS = 3.694e-8, 1.161e-5
TILT, YEARS = np.radians(60), 200

sim = rebound.Simulation()
sim.add(m=EARTH, r=RADIUS, name="Earth")  # the inner orbit first: WHFast splits it off
sim.add(m=MOON, r=MOON_RADIUS, a=32 * RADIUS, e=0.01, inc=TILT, name="Moon")
sim.add(m=1.0, a=1.0, e=0.0167)
sim.move_to_com()
earth, moon = sim.particles["Earth"], sim.particles["Moon"]
n = moon.orbit(primary=earth).n
sim.integrator, sim.dt = "whfast", 2 * np.pi / n / 60

tides = {"lag": 600 / 86400 * DAY}
spins = kr.rebound.attach(
    sim,
    {
        "Earth": kr.rebound.Body(
            0.3308 * EARTH * RADIUS**2, spin=(0, 0, 2 * np.pi / (5 / 24 * DAY)), love=0.298, **tides
        ),
        "Moon": kr.rebound.Body(
            0.393 * MOON * MOON_RADIUS**2, spin=n * np.array([0, -np.sin(TILT), np.cos(TILT)]), love=0.024, **tides
        ),
    },
)
before, rows = spins.angular_momentum(), []
for year in np.linspace(0, YEARS, 401):
    spins.integrate(year * YEAR)
    orbit = moon.orbit(primary=earth)
    rows.append((year, orbit.e, np.degrees(orbit.inc), orbit.a / RADIUS))
years, eccentricity, inclination, size = np.array(rows).T
change = np.linalg.norm(spins.angular_momentum() - before) / np.linalg.norm(before)
print(f"eccentricity up to {eccentricity.max():.2f}, inclination down to {inclination.min():.0f} degrees")
print(f"angular momentum of all changed by {change:.0e} of its size")
assert 0.6 < eccentricity.max() < 0.8 and 38 < inclination.min() < 50 and change < 1e-12

with figure("light", 7.0, 4.6) as (made, theme):
    panels = made.subplots(2, sharex=True)
    for panel, values, label in (
        (panels[0], eccentricity, "eccentricity"),
        (panels[1], inclination, "inclination, degrees"),
    ):
        panel.plot(years, values, color=theme.colours[0])
        panel.set_ylabel(label)
    panels[1].set_xlabel("years")
    made.savefig("tilted-moon.png")
