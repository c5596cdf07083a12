"""The parts of the trial, imported before any process is forked: their modules are then shared, and no thread runs."""

from __future__ import annotations

import warnings

import arguments
import calls
import clusters
import configurations
import corruptions
import kills
import llvmlite  # noqa: F401
import matplotlib.figure  # noqa: F401
import modes
import pandas  # noqa: F401
import scipy.integrate  # noqa: F401
import xarray  # noqa: F401
import zarr  # noqa: F401
from pool import Part

import kreisel.cli
import kreisel.lab.exact
import kreisel.sweeps.sweep
import kreisel.viewer.plots  # noqa: F401

PARTS = [
    Part("kills", kills.case, 300, 0.30, seconds=60, warm=kills.warm),
    Part("clusters", clusters.case, 12, 0.05, seconds=200, before=clusters.make),
    Part("modes", modes.case, 100, 0.05, before=corruptions.make),
    Part("corruptions", corruptions.case, 1000, 0.08, before=corruptions.make),
    Part("calls", calls.case, 40_000, 0.18, seconds=40, before=calls.make, warm=arguments.make),
    Part("configurations", configurations.case, 10_000, 0.34, before=corruptions.make),
]
warnings.simplefilter("ignore")
