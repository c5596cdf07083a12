"""The picture of a check case: rates against time, and the path of a body axis on the unit sphere."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kreisel.checkcases.laws import arrays, rotation
from kreisel.checkcases.motion import Case
from kreisel.viewer.style import figure

if TYPE_CHECKING:
    from kreisel.viewer.shown_figure import ShownFigure

ROWS = 1201
STILL = 1e-3  # an axis that moves less shows nothing


def plot(case: Case, theme: str = "light") -> ShownFigure:
    """Angular velocity along the body axes; in space, the body axis nearest to the momentum, or one that moves."""
    truth = case.reference(case.times(ROWS))
    time, w = truth.time.values, truth.angular_velocity.values
    momentum = truth.momentum.values[0]
    R = np.array(rotation(arrays(truth.attitude.values)))  # (3, 3, rows)
    axis = int(np.argmax(abs(R[:, :, 0].T @ momentum)))
    if np.ptp(R[:, axis], axis=1).max() < STILL:
        axis = (axis + 1) % 3
    path = R[:, axis].T
    with figure(theme, 7.4, 3.2) as (picture, colours):
        rates = picture.add_subplot(1, 2, 1)
        for k in range(3):
            rates.plot(time, w[:, k], color=colours.colour(k), linewidth=1.0, label=f"$\\omega_{k + 1}$")
        rates.set(xlabel="time (s)", ylabel="angular velocity, body axes (rad/s)", xlim=(0, time[-1]))
        rates.grid(True)
        rates.legend(loc="upper center", bbox_to_anchor=(0.5, 1.13), ncols=3, frameon=False)
        ball = picture.add_subplot(1, 2, 2, projection="3d")
        u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 49), np.linspace(0, np.pi, 25))
        globe = np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)
        ball.plot_wireframe(*globe, rstride=4, cstride=4, color=colours.faint, linewidth=0.3, alpha=0.6)
        ball.plot(*path.T, color=colours.colour(0), linewidth=0.8)
        ball.plot(*path[:1].T, "o", color=colours.ink, markerfacecolor=colours.colour(1), markersize=4, label="start")
        ball.plot(*path[-1:].T, "s", color=colours.ink, markerfacecolor=colours.colour(2), markersize=4, label="end")
        ball.set_box_aspect((1, 1, 1), zoom=1.25)
        ball.set_axis_off()
        ball.view_init(elev=22, azim=-55)
        ball.set_title(f"body axis {axis + 1} in space", y=0.98)
        ball.legend(loc="lower center", bbox_to_anchor=(0.5, -0.06), ncols=2, frameon=False)
        picture.suptitle(case.name, fontsize=10)
    return picture
