"""What every piece of work of `pages.py` imports, and a first run, before the processes are forked."""

import dask.array
import matplotlib.pyplot
import pint
import scipy.optimize
import sympy
import xarray
import zarr

import kreisel as kr
import kreisel.kernels.cpu
import kreisel.viewer.plots

TOP = kr.LagrangeTop(p=(0, 0, 1))
RUN = kr.simulate(TOP, TOP.state(m=(0.1, 0.2, 1.5), a=(0.6, 0, 0.8)), dt=0.05, steps=10)
__all__ = ["RUN", "TOP", "dask", "kreisel", "matplotlib", "pint", "scipy", "sympy", "xarray", "zarr"]
