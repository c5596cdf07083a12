"""Order by order: what a smaller step and a higher order buy.

The Bäcklund maps of order 2 to 12 against the closed form of the flow after time 20: the error falls with the slope of
the order until round-off, and every one of them keeps all integrals whatever the step.

Source: docs/baecklund.md of this project; Pade nodes of the exponential function.
"""

import os

import numpy as np

import kreisel as kr
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
T = 20.0
top = kr.LagrangeTop(p=(0, 0, 1))
x0 = top.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8))
truth = kr.at(top, x0, T)
orders = (2, 4) if SMALL else (2, 4, 6, 8, 12)
steps = np.array((20, 40, 80, 160)) if SMALL else np.array((20, 28, 40, 56, 80, 112, 160, 226, 320, 640, 1280))
errors, kept = {}, 0.0
for order in orders:
    runs = [kr.simulate(top, x0, dt=T / int(n), steps=int(n), every=int(n), order=order) for n in steps]
    errors[order] = np.array(
        [float(np.linalg.norm(r.a[-1] - truth.a) + np.linalg.norm(r.m[-1] - truth.m)) for r in runs]
    )
    kept = max(kept, *(abs(float(r.energy[-1] - r.energy[0])) for r in runs))
    use = (errors[order] > 1e-11) & (errors[order] < 0.7)  # neither round-off nor steps too long for the order to show
    slope = -np.polyfit(np.log(steps[use]), np.log(errors[order][use]), 1)[0]
    print(f"order {order}: measured {slope:.2f}")
    assert abs(slope - order) < 0.05 * order + 0.15
print(f"energy of all runs within {kept:.1e}")
assert kept < 1e-13

with figure("light", 5.6, 4.2) as (made, theme):
    axes = made.subplots()
    for order, colour in zip(orders, theme.colours, strict=False):
        axes.loglog(T / steps, errors[order], "o-", markersize=3.5, color=colour, label=f"order {order}")
    axes.set(xlabel="step", ylabel="error of the state at time 20", title="Bäcklund maps against the closed form")
    axes.legend()
    made.savefig("work_precision.png")
