"""Data of a page read back, and a run whose text is markup."""

from __future__ import annotations

import base64

import numpy as np

IDENTITY = (1.0, 0.0, 0.0, 0.0)
HOSTILE = "</script><script>document.title='owned'</script><img src=x onerror=\"document.title='owned'\"><!-- $data"


def array(text: str, kind: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype=f"<{kind}")


def turned(data: dict, points: np.ndarray, body: int = 0) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    g = Rotation.from_quat(array(data["bodies"][body]["turn"], "i2").reshape(-1, 4), scalar_first=True)
    return np.stack([g.apply(p) for p in np.atleast_2d(points)], 1)


def tip(data: dict, body: int = 0) -> np.ndarray:
    """Where the page draws it: by the turn of its axis, or as it is sent."""
    each = data["bodies"][body]
    if each["axis"] is not None:
        return turned(data, np.array(each["axis"]), body)[:, 0]
    return array(each["tip"], "f4").reshape(-1, len(data["names"]))


def points(data: dict) -> np.ndarray:
    return array(data["meshes"][0]["points"], "f4").reshape(-1, 3)


def hostile(run):
    attrs = {k: HOSTILE if isinstance(v, str) else v for k, v in run.attrs.items()}
    keep = ("system", "components", "frame", "parameters", "method")
    return run.rename(energy=HOSTILE).assign_attrs({**attrs, **{k: run.attrs[k] for k in keep}})
