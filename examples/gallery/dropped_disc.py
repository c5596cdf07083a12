"""A disc dropped in water: edgewise it does not go down.

A plastic disc, a tenth heavier than the water that it displaces, is let go edge down, five degrees off.  Gliding along
an edge is unstable, since the water that must be moved is least there: P x U turns the disc broadside.  With drag it
settles, flat, at the speed at which its drag is its weight in water.  Without drag and weight, a disc that glides
broadside rocks with the frequency w^2 = P^2 (1/m_1 - 1/m_3)/I_1 of linear theory, m_i and I_i with the added ones.

Source: H. Lamb, Hydrodynamics, 6th ed., sections 124 and 126; added masses: sections 114, 115.
"""

import numpy as np

import kreisel as kr
from kreisel import analysis
from kreisel.physical import STANDARD_GRAVITY, SubmergedBody
from kreisel.viewer.charts import figure

HALF = np.radians(95) / 2  # the axis of the disc is the third, level but for five degrees
EDGEWISE = (np.cos(HALF), 0.0, np.sin(HALF), 0.0)
axes = (0.05, 0.05, 0.005)  # m
volume = 4 / 3 * np.pi * np.prod(axes)
drag = (0.05, 0.05, 5.0, 2e-4, 2e-4, 2e-5)  # N s^2/m^2 along the axes and N m s^2 about them: of a plate broadside
slow = (0.0, 0.0, 0.0, 2e-4, 2e-4, 2e-5)  # N s/m and N m s
disc = SubmergedBody.ellipsoid(axes, 1.1 * 1000 * volume, 1000.0, linear_drag=slow, quadratic_drag=drag)
run = kr.simulate(disc, disc.state(attitude=EDGEWISE), dt="5 ms", t_end="30 s", every="20 ms")
course = disc.course(run)
g = kr.algebra.rotation_matrix(run.attitude.values)
tilt = np.degrees(np.arccos(np.clip(abs(g[:, 2, 2]), 0, 1)))  # of the axis to the vertical
speed = np.linalg.norm(course.velocity, axis=-1)
terminal = np.sqrt((disc.mass - disc.displaced_mass) * STANDARD_GRAVITY / drag[2])
print(f"tilt {tilt[0]:.0f} degrees at first, {tilt[-1]:.2f} at the end")
print(f"it sinks at {-np.diff(course.position[-2:, 2])[0] / 0.02:.4f} m/s; weight and drag: {terminal:.4f} m/s")
assert tilt[0] > 80 and tilt[-1] < 5
assert abs(speed[-1] - terminal) < 0.02 * terminal
assert float(abs(run.balance - run.balance[0]).max()) < 1e-6 * float(abs(run.work).max())

free = SubmergedBody.ellipsoid(axes, 1.1 * 1000 * volume, 1000.0, gravity=0.0)
glide = kr.simulate(free, free.state(velocity=(1e-5, 0, 0.2)), dt="10 ms", t_end="200 s")
m, I = np.diag(free.mass_matrix)[:3], np.diag(free.mass_matrix)[3:]
linear = m[2] * 0.2 * np.sqrt((1 / m[0] - 1 / m[2]) / I[0])
found = abs(analysis.frequencies(glide, "linear_momentum[0]", lines=1).frequency[0])
print(f"rocking broadside: {found:.6f} rad/s, linear theory {linear:.6f}")
assert abs(found - linear) < 1e-6 * linear

with figure("light", 9.2, 3.7) as (made, theme):
    left, right = made.subplots(1, 2, width_ratios=(1, 3))
    x, z = course.position[:, 0], course.position[:, 2]
    left.plot(x, z, color=theme.colours[0], linewidth=0.8)
    for row in range(0, 300, 12):
        edge = 0.05 * np.array([g[row, 0, 0], g[row, 2, 0]])
        left.plot(
            [x[row] - edge[0], x[row] + edge[0]],
            [z[row] - edge[1], z[row] + edge[1]],
            color=theme.colours[1],
            linewidth=1.2,
        )
    left.set(xlabel="m", ylabel="height, m", title="the disc on its way down", ylim=(z[300], 0.1), aspect="equal")
    right.plot(run.time, tilt, color=theme.colours[0])
    right.set(xlabel="time, s", ylabel="degrees", title="tilt of its axis to the vertical", xlim=(0, 8))
    made.savefig("dropped_disc.png")
