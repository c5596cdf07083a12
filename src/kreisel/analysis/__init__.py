"""kr.analysis: angles, rates and paths, events, sections, frequencies, comparison of runs, light curves.

    run = kr.simulate(top, x0, dt=0.05, steps=20_000, orientation=(1, 0, 0, 0))
    kr.analysis.euler_angles(run)                      # phi, theta, psi
    kr.analysis.mean_rates(run)                        # nutation and precession, measured and in closed form
    kr.analysis.angular_velocity(run)                  # Omega along the axes of the body; frame="space": omega
    kr.analysis.pointing(run, target="sun")            # of a satellite: pitch, roll, yaw, angle to the Sun
    kr.analysis.section(run, "a[1]", rising=True)      # Poincare's section a_2 = 0, located to round-off
    kr.analysis.frequencies(run, "a[0]")               # to 1e-10 and better
    kr.analysis.error(run)                             # its error at each row, by a run with half the step

Every function accepts a run of `kr.simulate`, `kr.open_run` or `kr.resume`.  A quantity is a name such as "a[2]",
counted from 0 as in `kr.drift`, or a function of the components of the state.  The result is an `xarray.Dataset`, a
table of pandas, or a small record with a `plot()`; `kreisel.viewer.charts` draws all of them.
"""

from kreisel.analysis.angles import (
    angular_velocity,
    euler_angles,
    mean_rates,
    path,
    pointing,
    quaternions,
    rates,
    rotations,
)
from kreisel.analysis.comparison import Comparison, compare, error
from kreisel.analysis.events import events, return_map, section
from kreisel.analysis.frequencies import Lines, frequencies, megno, power_spectrum
from kreisel.analysis.light import brightness, light_curve
from kreisel.analysis.photometry import TumblerFit, fit_light_curve

__all__ = [name for name, value in globals().items() if name[0] != "_" and type(value).__name__ != "module"]
