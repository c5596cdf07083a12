"""Two tops that exchange their precession, and the waves of a chain of a hundred.

Fast tops upright in a row, with axial momentum s and p = a = 1, whose axes attract their neighbours': V = -k a_i.a_j.
Small tilts z = a1 + i a2 obey z_j'' - i s z_j' - z_j + k (sum over the neighbours i of z_j - z_i) = 0.  The modes of a
chain with free ends are z_j = cos(q (j + 1/2)) exp(i w t), q = pi n/N, with a slow and a fast precession,

    w = s/2 -+ sqrt(s^2/4 - 1 + 2 k (1 - cos q)).

Left: of two tops one is tilted.  Its precession goes over to the other in the time pi/(difference of the slow w).
Right: spectrum of a chain that begins with random tilts, over the curves of the two branches.

Source: the equations of the Lagrange top, linear about the vertical; C. Kittel, Introduction to Solid State Physics,
chapter 4, for the modes of a chain.
"""

import os

import numpy as np
from scipy.fft import dct
from scipy.signal.windows import hann

import kreisel as kr
from kreisel.viewer.charts import figure

SMALL = "KREISEL_SMALL" in os.environ
SPIN, TILT, DT = 3.0, 1e-4, 0.2


def attraction(a1, a2, *, k):
    return -k * (a1 @ a2)


def chain(count, k):
    """Tops in a row."""
    pairs = [(i, i + 1) for i in range(count - 1)]
    return kr.perturbed(kr.LagrangeTop(p=(0, 0, 1)), pair_potential=attraction, pairs=pairs, params={"k": k})


def start(body, z, rate):
    """The state of tops with tilts z that change by z' = rate."""
    a = np.stack([z.real, z.imag, np.sqrt(1 - abs(z) ** 2)], -1)
    change = np.stack([rate.real, rate.imag, -(z.conj() * rate).real / a[:, 2]], -1)
    return body.state(m=np.cross(a, change) + SPIN * a, a=a)


def tilts(run):
    return (run.a[..., 0] + 1j * run.a[..., 1]).values


def frequencies(k, q):
    root = np.sqrt(SPIN**2 / 4 - 1 + 2 * k * (1 - np.cos(q)))
    return SPIN / 2 - root, SPIN / 2 + root


# -- two tops: modes q = 0 and pi/2
WEAK = 0.02
two = chain(2, WEAK)
slow = [frequencies(WEAK, q)[0] for q in (0, np.pi / 2)]
exchange = np.pi / abs(slow[0] - slow[1])
sum_and_difference = TILT * np.array([0.5, 0.5]), TILT * np.array([0.5, -0.5])
rate = sum(1j * w * part for w, part in zip(slow, sum_and_difference, strict=True))
beat = kr.simulate(two, start(two, TILT * np.array([1 + 0j, 0]), rate), dt=DT, steps=int(2.2 * exchange / DT))
size = abs(tilts(beat)) / TILT
found = float(beat.time[size[: int(1.5 * exchange / DT), 1].argmax()])
print(f"two tops: the second has all of the tilt at {found:.1f}, linear theory {exchange:.1f}")
assert abs(found / exchange - 1) < 0.01 and size[:, 1].max() > 0.999 and size[0, 1] == 0

# -- a chain
COUNT, STRONG, ROWS = (20, 0.5, 1024) if SMALL else (100, 0.5, 4096)
body = chain(COUNT, STRONG)
noise = TILT * np.random.default_rng(1).normal(size=(2, COUNT, 2)) @ (1, 1j)
waves = kr.simulate(body, start(body, *noise), dt=DT, steps=2 * (ROWS - 1), every=2)
modes = dct(tilts(waves).real, axis=1) + 1j * dct(tilts(waves).imag, axis=1)
spectrum = abs(np.fft.fft(modes * hann(ROWS)[:, None], axis=0))
w = 2 * np.pi * np.fft.fftfreq(ROWS, 2 * DT)
q = np.pi * np.arange(COUNT) / COUNT
off = []
for branch in frequencies(STRONG, q):
    for n, expected in enumerate(branch):
        near = np.flatnonzero(abs(w - expected) < 0.1)
        off.append(w[near[spectrum[near, n].argmax()]] - expected)
line = 2 * np.pi / (ROWS * 2 * DT)
print(f"{COUNT} tops: {len(off)} lines, at most {max(map(abs, off)) / line:.2f} spacings of the spectrum from theory")
assert max(map(abs, off)) < 0.75 * line
shown = (-0.5 < w) & (w < 3.7)
on_lines = np.min([abs(w[shown, None] - branch) for branch in frequencies(STRONG, q)], 0) < 3 * line
share = (spectrum[shown] ** 2)[on_lines].sum() / (spectrum[shown] ** 2).sum()
energy = abs(waves.total_energy - waves.total_energy[0]).max().item()
about = abs(waves.total_noether - waves.total_noether[0]).max().item()
print(f"{100 * share:.2f} % of the power on the lines; energy of all to {energy:.0e}, the sum of m.p to {about:.0e}")
assert share > 0.99 and energy < 1e-6 and about < 1e-10

with figure("light", 10.0, 4.0) as (made, theme):
    left, right = made.subplots(1, 2, width_ratios=[1, 1.15])
    for k, name in enumerate(("first", "second")):
        left.plot(beat.time, size[:, k], color=theme.colours[k], linewidth=1.2, label=name)
    left.axvline(exchange, color=theme.ink, linestyle="--", linewidth=1, label="linear theory")
    left.set(xlabel="time", ylabel="tilt, of that at the start", title=f"two tops, k = {WEAK:g}")
    left.legend(ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.14), columnspacing=1, handlelength=1.2)
    inside = np.argsort(w)[np.sort(w) > -0.5][:-1]
    inside = inside[: len(inside) // 4 * 4].reshape(-1, 4)  # four neighbours are one line of the picture
    power = np.log10((spectrum[inside] ** 2).max(1) / (spectrum**2).max())
    image = right.pcolormesh(q, w[inside].mean(1), power, vmin=-4, vmax=0, cmap="Blues", shading="nearest")
    for branch in frequencies(STRONG, np.linspace(0, np.pi, 200)):
        right.plot(np.linspace(0, np.pi, 200), branch + 0.1, color=theme.ink, linewidth=0.8, linestyle="--")
    right.set(xlabel="wave number q", ylabel="frequency w", ylim=(-0.5, 3.7),
              title=f"a chain of {COUNT}, k = {STRONG:g}; dashed: theory + 0.1")  # fmt: skip
    made.colorbar(image, label="log10 of the power")
    made.savefig("coupled_tops.png")
