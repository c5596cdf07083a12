"""Mass, centre of mass and inertia tensor of a body, from its shape in a mesh file or from a robot description."""

from __future__ import annotations

import logging
import os
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from kreisel.algebra import Array
from kreisel.errors import InputError, explained, hint, shown
from kreisel.files import place
from kreisel.physical.inertia import inertia_tensor
from kreisel.physical.measures import in_range, si_number

SUFFIXES = (".stl", ".obj", ".ply", ".glb", ".gltf")
LARGEST_MESH, LARGEST_DESCRIPTION = 1 << 30, 16 << 20  # bytes
LARGEST = 1e30  # coordinate
MOST_SHELLS = 64  # of which a face is checked: each costs a pass over all triangles
BELOW = 1e-6  # of the size of a triangle
ENTRIES = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
ROTATIONS = ("euler_rpy", "quat_xyzw")


class Part(NamedTuple):
    """Mass, kg, centre of mass (3,), m, and inertia tensor about it (3, 3), kg m^2, along the axes of the file.

    The names are arguments of the bodies: `SubmergedBody(**part._asdict())`, `Satellite(part.inertia, orbit)`,
    `HeavyBody.about_centre(part.mass, part.inertia, arm=part.center_of_mass)` with the pivot at the file's origin.
    """

    mass: float
    center_of_mass: Array
    inertia: Array


@explained
def read_mesh(mesh: str | os.PathLike[str], length: Any = None, density: Any = None, mass: Any = None) -> Part:
    """The homogeneous body whose closed surface is in a mesh file: STL, OBJ, PLY or glTF (extra `mesh`: trimesh).

    length          the unit of the coordinates: "mm", or its size in m; files do not state it
    density, mass   kg/m^3 or kg: one of them

    Cavities are surfaces within, their normals towards the cavity.  Raises `InputError` for a surface with holes or
    with normals that point inwards, and for bodies within one another; overlaps of parts of them may not be noticed.
    """
    file = _file(mesh, "mesh", LARGEST_MESH)
    if file.suffix.lower() not in SUFFIXES:
        raise InputError(f"mesh: expected a file that ends in {', '.join(SUFFIXES)}, got {shown(file.name)}.")
    if length is None:
        raise InputError(
            f"length: expected the unit of the coordinates in {file.name}, such as length='mm', got none. Mesh files "
            "do not state it; most CAD programs write mm."
        )
    unit = si_number(length, "m", "length", positive=True)
    if (density is None) == (mass is None):
        raise InputError(
            f"expected density=..., such as '2700 kg/m^3' for aluminium, or mass=..., got "
            f"{'neither' if mass is None else 'both'}."
        )
    surface = _surface(file)
    middle = surface.bounds.mean(0)
    surface.apply_translation(-middle)  # integrals far from the origin lose digits
    with np.errstate(all="ignore"):
        _require_closed(surface, file.name)
        sizes = surface.mass_properties
    volume = in_range("The volume", lambda: sizes.volume * unit**3)
    total = (
        in_range("The mass", lambda: volume * si_number(density, "kg/m^3", "density", positive=True))
        if (mass is None)
        else si_number(mass, "kg", "mass", positive=True)
    )
    inertia = in_range("The inertia tensor", lambda: sizes.inertia * (total / sizes.mass * unit**2))
    return Part(float(total), (sizes.center_mass + middle) * unit, inertia_tensor(inertia / 2 + inertia.T / 2 + 0.0))


def _surface(file: Path) -> Any:
    """The triangles of a file, equal points merged.  Raises `InputError`."""
    try:
        import trimesh
    except ImportError:
        raise InputError(
            "Reading a mesh needs trimesh, which is not installed: pip install 'kreisel[mesh]'. Or give the inertia "
            "tensor and the mass that your CAD program shows."
        ) from None
    log = logging.getLogger("trimesh")  # it would print tracebacks of damaged files
    level = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        with np.errstate(all="ignore"):
            surface = trimesh.load_scene(file).to_mesh()
            triangles, points = len(surface.faces), np.asarray(surface.vertices)
            sound = triangles > 0 and points.shape[1:] == (3,) and (abs(points) < LARGEST).all()
            sound = sound and np.ptp(surface.bounds, axis=0).all()
    except Exception as error:  # any exception of the readers for a damaged file
        raise InputError(f"{file}: expected a complete {file.suffix[1:].upper()} file, got {error!r}.") from error
    finally:
        log.setLevel(level)
    if not sound:
        raise InputError(
            f"{file}: expected a surface of triangles around a volume, got {triangles:,} triangles. Usual cause: "
            "a damaged file, or one of points only."
        )
    return surface


def _require_closed(surface: Any, name: str) -> None:
    """Raises `InputError` unless the surface is the boundary of a volume, seen from outside."""
    fix = "In Blender: Mesh > Normals > Recalculate Outside; in MeshLab: Re-Orient All Faces Coherently."
    if not surface.is_watertight:
        edges = np.sort(surface.edges, axis=1)
        open_edges = int((np.unique(edges, axis=0, return_counts=True)[1] != 2).sum())
        raise InputError(
            f"{name}: expected a closed surface, each edge between two triangles, got {open_edges:,} other edges. "
            "Close its holes and join double faces, in Blender by Mesh > Clean Up > Fill Holes and Merge by Distance, "
            "or export it again from CAD as one solid."
        )
    if not surface.is_winding_consistent:
        raise InputError(f"{name}: expected normals that all point outwards, got triangles that disagree. {fix}")
    if not surface.volume > 0:
        raise InputError(f"{name}: expected normals that point outwards, got them inwards: it is inside out. {fix}")
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pairs, count = surface.face_adjacency, len(surface.faces)
    shells = connected_components(coo_array((np.ones(len(pairs)), pairs.T), shape=(count, count)), directed=False)[1]
    largest = np.lexsort((-surface.area_faces, shells))
    faces = largest[np.unique(shells[largest], return_index=True)[1]][:MOST_SHELLS]
    for face in faces if len(faces) > 1 else ():
        below = surface.triangles_center[face] - BELOW * np.sqrt(surface.area_faces[face]) * surface.face_normals[face]
        layers = round(_winding_number(surface.triangles - below))
        if layers != 1:
            fault = "bodies within one another" if layers > 1 else "one of its surfaces inside out"
            raise InputError(
                f"{name}: expected separate bodies, and normals that point out of the material, got {fault}. Join the "
                f"bodies by a Boolean union. {fix}"
            )


def _winding_number(triangles: Array) -> float:
    """The times that triangles (k, 3, 3) enclose the origin: the sum of their solid angles over 4 pi.

    [van Oosterom, Strackee, IEEE Transactions on Biomedical Engineering 30 (1983) 125]
    """
    a, b, c = np.moveaxis(triangles, 1, 0)
    x, y, z = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    dots = [(u * v).sum(-1) for u, v in ((a, b), (b, c), (c, a))]
    angles = 2 * np.arctan2((np.cross(a, b) * c).sum(-1), x * y * z + dots[0] * z + dots[1] * x + dots[2] * y)
    return float(angles.sum() / (4 * np.pi))


@explained
def read_robot(robot: str | os.PathLike[str], link: str | None = None) -> Part:
    """The mass, centre of mass and inertia tensor of a link, along the axes of the link, from a URDF or SDF file.

    link   its name, in SDF also "model::link"; not needed if only one link has an inertia

    ixy, ixz, iyz are entries of the tensor, -sum m x y and so on.  Raises `InputError` for other files, and if the
    link is missing or states no inertia.  [ROS, URDF link; Open Robotics, SDFormat 1.12, inertial]
    """
    file = _file(robot, "robot", LARGEST_DESCRIPTION)
    raw = file.read_bytes()
    if b"<!DOCTYPE" in raw or b"<!ENTITY" in raw:
        raise InputError(
            f"{file.name}: expected a URDF or SDF file, got a document type or entities, which neither has."
        )
    try:
        root = ElementTree.fromstring(raw)
    except (ElementTree.ParseError, ValueError) as error:
        raise InputError(f"{file.name}: expected a URDF or SDF file, got no XML: {error}.") from None
    if root.tag not in ("robot", "sdf"):
        raise InputError(f"{file.name}: expected <robot> or <sdf> at the top, got <{shown(root.tag)[1:-1]}>.")
    links = dict(_links(root, ""))
    inertials = {name: element.find("inertial") for name, element in links.items()}
    chosen = [k for k in links if k == link or k.endswith(f"::{link}")]
    if link is None:
        chosen = [k for k, inertial in inertials.items() if inertial is not None]
    if len(chosen) != 1:
        raise InputError(
            f"link: expected one of {', '.join(links) or 'none'} of {file.name}, got {shown(link)}.{hint(link, links)}"
        )
    inertial = inertials[chosen[0]]
    if inertial is None or inertial.get("auto") == "true":
        got = "none" if inertial is None else 'auto="true"; read its mesh by read_mesh'
        raise InputError(f"{file.name}: expected <inertial> in the link {chosen[0]}, got {got}.")
    return _of_inertial(inertial, f"{file.name}, link {chosen[0]}", root.tag == "sdf")


def _links(element: ElementTree.Element, prefix: str) -> list[tuple[str, ElementTree.Element]]:
    """The links of a robot, a model or a world, by name; in nested models "model::link"."""
    found = [(prefix + each.get("name", ""), each) for each in element.findall("link")]
    for group in ("world", "model"):
        for each in element.findall(group):
            inner = prefix if group == "world" or element.tag == "sdf" else ""
            found += _links(each, f"{inner}{each.get('name', '')}::" if group == "model" else prefix)
    return found


def _of_inertial(inertial: ElementTree.Element, name: str, sdf: bool) -> Part:
    """The mass properties of an element <inertial>.  Raises `InputError`."""
    if sdf:
        values = {key: _numbers(inertial.findtext(f"inertia/{key}"), 1, f"{name}, {key}")[0] for key in ENTRIES}
        mass = _numbers(inertial.findtext("mass"), 1, f"{name}, mass")
        centre, R = _pose(inertial.find("pose"), name)
    else:
        tensor, weight, origin = (inertial.find(tag) for tag in ("inertia", "mass", "origin"))
        values = {key: _numbers(None if tensor is None else tensor.get(key), 1, f"{name}, {key}")[0] for key in ENTRIES}
        mass = _numbers(None if weight is None else weight.get("value"), 1, f"{name}, mass")
        centre, rpy = (
            _numbers("0 0 0" if origin is None else origin.get(key, "0 0 0"), 3, f"{name}, {key}")
            for key in ("xyz", "rpy")
        )
        R = _rotation(rpy)
    xx, xy, xz, yy, yz, zz = values.values()
    inertia = inertia_tensor([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], name)
    turned = R @ inertia @ R.T
    return Part(
        si_number(mass[0], "kg", f"{name}, mass", positive=True),
        centre,
        inertia_tensor(turned / 2 + turned.T / 2, name),
    )


def _pose(pose: ElementTree.Element | None, name: str) -> tuple[Array, Array]:
    """Position and rotation of an element <pose> of SDF.  Raises `InputError`."""
    if pose is None:
        return np.zeros(3), np.eye(3)
    form, frame = pose.get("rotation_format", "euler_rpy"), pose.get("relative_to")
    if form not in ROTATIONS or frame:
        raise InputError(
            f"{name}, pose: expected a rotation_format of {', '.join(ROTATIONS)} and no relative_to, got "
            f"{shown(form)}, {shown(frame)}."
        )
    x = _numbers(pose.text, 6 + (form == "quat_xyzw"), f"{name}, pose")
    if form == "quat_xyzw":
        from scipy.spatial.transform import Rotation

        if abs(np.linalg.norm(x[3:]) - 1) > 1e-6:
            raise InputError(f"{name}, pose: expected a unit quaternion, got {x[3:].tolist()}.")
        return x[:3], Rotation.from_quat(x[3:]).as_matrix()
    return x[:3], _rotation(np.radians(x[3:]) if pose.get("degrees") == "true" else x[3:])


def _rotation(rpy: Array) -> Array:
    """R = R_z(yaw) R_y(pitch) R_x(roll): about the fixed axes, roll first."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("xyz", rpy).as_matrix())


def _numbers(text: str | None, count: int, name: str) -> Array:
    """Finite floats, `count` of them, from text.  Raises `InputError`."""
    try:
        values = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        values = np.array([])
    if values.shape != (count,) or not np.isfinite(values).all():
        macro = (
            " Usual cause: a file of xacro; expand it: xacro robot.xacro > robot.urdf." if "$" in (text or "") else ""
        )
        raise InputError(f"{name}: expected {count} number{'s' * (count > 1)}, got {shown(text)}.{macro}")
    return values


def _file(path: Any, name: str, most: int) -> Path:
    """A file that exists and is not too large.  Raises `InputError`."""
    file = place(path, f"{name}: expected the name of a file")
    try:
        size = file.stat().st_size
        with file.open("rb"):
            pass
    except OSError as error:
        raise InputError(f"{name}: {file} cannot be read: {error.strerror or error}.") from None
    if size > most:
        raise InputError(f"{name}: expected a file of at most {most >> 20:,} MiB, got {size >> 20:,} MiB.")
    return file
