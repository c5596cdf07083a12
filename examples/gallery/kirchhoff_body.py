"""A body that tumbles in a fluid: point first is unstable, broadside on is stable.

An ellipsoid as heavy as the water that it displaces glides along its long axis; a disturbance of a thousandth of its
velocity makes it tumble, although no force acts but that of the ideal fluid.  Along its short axis it glides on.  The
variational integrator keeps the Casimirs |P|^2 and M.P to round-off.

Source: H. Lamb, Hydrodynamics, 6th ed., section 124; added masses: sections 114, 115 (`kreisel.physical.Ellipsoid`).
"""

import numpy as np

import kreisel as kr
from kreisel import analysis
from kreisel.physical import Ellipsoid
from kreisel.viewer.charts import figure

body = Ellipsoid.of_density((0.30, 0.15, 0.10), density=1000.0, fluid_density=1000.0)  # m, kg/m^3
runs = {}
for name, velocity in (("point first", (1.0, 1e-3, 1e-3)), ("broadside", (1e-3, 1e-3, 1.0))):
    x0 = body.state(velocity, (0.0, 0.0, 0.0))
    runs[name] = kr.simulate(body, x0, dt="5 ms", t_end="60 s", every="20 ms", order=4)

turned = {}
for name, run in runs.items():
    drift = kr.drift(run)
    g = analysis.rotations(run).as_matrix()
    leading = 0 if name == "point first" else 2
    axis = g[:, :, leading]
    turned[name] = np.degrees(np.arccos(np.clip(axis @ axis[0], -1, 1)))
    print(
        f"{name}: turns by up to {turned[name].max():.2f} degrees; "
        f"worst Casimir off by {drift.ulps[drift.conserved].max():.0f} units in the last place"
    )
    assert drift.ulps[drift.conserved].max() < 400
assert turned["point first"].max() > 90 and turned["broadside"].max() < 1

with figure("light", 9.2, 3.7) as (made, theme):
    sphere = made.add_subplot(1, 2, 1, projection="3d")
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 49), np.linspace(0, np.pi, 25))
    ball = (np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v))
    sphere.plot_wireframe(*ball, rstride=4, cstride=4, color=theme.grid, linewidth=0.3)
    sphere.plot(*analysis.rotations(runs["point first"]).as_matrix()[:, :, 0].T, color=theme.colours[0], linewidth=0.8)
    sphere.set_box_aspect((1, 1, 1), zoom=1.3)
    sphere.set_axis_off()
    sphere.set_title("the long axis in space, point first", y=1.0)
    axes = made.add_subplot(1, 2, 2)
    for (name, angle), colour in zip(turned.items(), theme.colours, strict=False):
        axes.plot(runs[name].time, angle, color=colour, label=name)
    axes.set(xlabel="time, s", ylabel="degrees", title="angle of the leading axis to its start")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
    made.savefig("kirchhoff_body.png")
