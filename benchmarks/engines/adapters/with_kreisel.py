"""Kreisel by its public calls.  Setting: a method and its order, if it has several.

Free bodies are kr.physical.FreeBody, the heavy top is kr.physical.HeavyBody, and kr.physical.Gyroscope for the methods
that need its symmetry about the axis from the pivot to the centre of mass, here y: the third axis of a Gyroscope.
"""

import numpy as np
from scipy.spatial.transform import Rotation
from wire import about_pivot, serve

import kreisel as kr

SYMMETRIC = ("exact", "baecklund", "suris")
SWAP = Rotation.from_matrix([[0, 1, 0], [0, 0, 1], [1, 0, 0]])  # z, x, y of the body are x, y, z of the Gyroscope


def gyroscope(job):
    """The model, its start and its reader; momentum and axis are along the axes of space, where up is z."""
    mass, moments = job["mass"], np.diag(about_pivot(job))
    top = kr.physical.Gyroscope(mass, moments[1], moments[0], job["arm"][1], -job["gravity"][2])
    turn = Rotation.from_quat(job["attitude"], scalar_first=True)
    momentum = turn.apply(moments * job["angular_velocity"]) / top.momentum_unit
    state = {"m": momentum, "a": turn.apply([0, 1, 0]), "g": (turn * SWAP.inv()).as_quat(scalar_first=True)}

    def read(x):
        turn = Rotation.from_quat(x["g"], scalar_first=True) * SWAP
        return turn.as_quat(scalar_first=True), turn.inv().apply(x["m"] * top.momentum_unit) / moments

    return top, state, read


def body(job):
    """The model, its start and its reader, of a free body and of a heavy one."""
    spin, attitude = job["angular_velocity"], job["attitude"]
    if job["arm"]:
        heavy = kr.physical.HeavyBody(job["mass"], about_pivot(job), job["arm"], -job["gravity"][2])
        up = Rotation.from_quat(attitude, scalar_first=True).as_matrix()[2]
        return heavy, {**heavy.state(spin, up), "g": attitude}, lambda x: (x["g"], heavy.angular_velocity(x["M"]))
    free = kr.physical.FreeBody(job["inertia"])
    state = {**free.state(spin), "g": free.orientation(attitude)}
    return free, state, lambda x: (free.attitude(x["g"]), free.angular_velocity(x["M"]))


def start(job):
    method, *order = job["setting"].split()
    thing, state, read = (gyroscope if job["arm"] and method in SYMMETRIC else body)(job)
    dt = thing.dt(job["dt"])
    options = {} if method == "exact" else {"dt": dt, "order": int(order[0]) if order else None}
    move = kr.propagator(thing.model(), method=method, orientation=True, **options)
    exact = method == "exact"
    rows = move.at(state, [0.0]) if exact else move.steps(state, 1, every=1)  # compiles the kernel
    now = [{letter: values[0] for letter, values in rows.items()}]

    def advance(n):
        now[0] = move.at(now[0], n * dt) if exact else move.steps(now[0], n)

    return advance, lambda: read(now[0])


serve(start, frame="body")
