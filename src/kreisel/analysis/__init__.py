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
    angular_velocity as angular_velocity,
    euler_angles as euler_angles,
    mean_rates as mean_rates,
    path as path,
    pointing as pointing,
    quaternions as quaternions,
    rates as rates,
    rotations as rotations,
)
from kreisel.analysis.comparison import Comparison as Comparison, compare as compare, error as error
from kreisel.analysis.events import events as events, return_map as return_map, section as section
from kreisel.analysis.frequencies import (
    Lines as Lines,
    frequencies as frequencies,
    megno as megno,
    power_spectrum as power_spectrum,
)
from kreisel.analysis.light import brightness as brightness, light_curve as light_curve
from kreisel.analysis.photometry import TumblerFit as TumblerFit, fit_light_curve as fit_light_curve

__all__ = [name for name, value in globals().items() if name[0] != "_" and type(value).__name__ != "module"]
