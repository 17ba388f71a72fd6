"""A URDF as one rigid body: all of its links, with the joints at zero, in metres."""

import re
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import trimesh
from numpy.typing import NDArray

from tacgen.core.errors import ObjectError
from tacgen.core.types import M_PER_MM, MM_PER_M

MAX_BYTES = 4 << 20
MAX_SHAPES = 1000  # of one URDF: an object has a few
MAX_TRIANGLES = 2_000_000
SECTIONS = 256  # around a cylinder, whose facets a gel would show
MOST = 1e6  # of any number, m or rad
FOLDERS_UP = 2  # from the URDF's, within which its meshes lie: package/urdf/model/model.urdf

ReadMesh = Callable[[Path], trimesh.Trimesh]


def read_urdf(path: Path, read_mesh: ReadMesh) -> tuple[trimesh.Trimesh, list[str]]:
    """The shapes that are seen, of a link that has none those that collide; and notes.

    Meshes are read by ``read_mesh``, from the URDF's own folders only.

    Raises ``ObjectError`` if it is no URDF, or what it refers to cannot be read.
    """
    robot = _parsed(path)
    links = {str(link.get("name")): link for link in robot.findall("link")}
    poses = _poses(path, robot, links)
    shapes, triangles, cache = list[trimesh.Trimesh](), 0, dict[Path, trimesh.Trimesh]()
    for name, link in links.items():
        for shape in link.findall("visual") or link.findall("collision"):
            solid = _solid(path, shape, read_mesh, cache)
            solid = solid.apply_transform(poses[name] @ _origin(path, shape))
            triangles += len(solid.faces)
            shapes.append(solid)
            if len(shapes) > MAX_SHAPES or triangles > MAX_TRIANGLES:
                msg = (
                    f"{path}: has more than {MAX_SHAPES} shapes or {MAX_TRIANGLES} triangles; "
                    "give a URDF of one object, or decimate its meshes"
                )
                raise ObjectError(msg)
    if not shapes:
        msg = f"{path}: its links have no shape; give a URDF with meshes or solids"
        raise ObjectError(msg)
    notes = []
    moving = [one for one in robot.findall("joint") if one.get("type") != "fixed"]
    if len(links) > 1:
        held = f", its {len(moving)} joints that move held at 0" if moving else ""
        notes.append(f"{len(links)} links are one rigid body{held}")
    starts = np.cumsum([0, *(len(solid.vertices) for solid in shapes[:-1])])
    faces = [solid.faces + start for solid, start in zip(shapes, starts, strict=True)]
    points = np.concatenate([solid.vertices for solid in shapes])
    return trimesh.Trimesh(points, np.concatenate(faces), process=False), notes


def _parsed(path: Path) -> ElementTree.Element:
    data, problem = path.read_bytes() if path.stat().st_size <= MAX_BYTES else b"", ""
    if not data:
        problem = f"is empty or larger than {MAX_BYTES >> 20} MiB; give the URDF of an object"
    elif b"<!" in data.replace(b"<!--", b""):
        problem = "declares a document type; remove it, a URDF needs none"
    elif b"xacro:" in data:
        problem = "is a xacro file; run `xacro` on it and give the URDF that comes out"
    if not problem:
        try:
            robot = ElementTree.fromstring(data)
        except (ElementTree.ParseError, ValueError, LookupError) as error:
            problem = f"cannot be read as URDF: {error}; export it anew"
        else:
            if robot.tag == "robot":
                return robot
            problem = f"is no URDF: its root is <{robot.tag[:40]}>, not <robot>"
    msg = f"{path}: {problem}"
    raise ObjectError(msg)


def _poses(
    path: Path, robot: ElementTree.Element, links: dict[str, ElementTree.Element]
) -> dict[str, NDArray[np.float64]]:
    """The pose (4, 4) of each link, m."""
    above = {}
    for joint in robot.findall("joint"):
        parent, child = (
            "" if (end := joint.find(tag)) is None else str(end.get("link"))
            for tag in ("parent", "child")
        )
        if parent not in links or child not in links or child in above:
            msg = f"{path}: joint {joint.get('name')!r} does not join two links; correct it"
            raise ObjectError(msg)
        above[child] = parent, _origin(path, joint)
    poses = dict[str, NDArray[np.float64]]()
    for name in links:
        chain, at = list[str](), name
        while at in above and at not in poses and len(chain) <= len(links):
            chain.append(at)
            at = above[at][0]
        if len(chain) > len(links):
            msg = f"{path}: its joints go round in a circle at {name!r}; correct them"
            raise ObjectError(msg)
        poses.setdefault(at, np.eye(4))
        for link in reversed(chain):
            parent, origin = above[link]
            poses[link] = poses[parent] @ origin
    return poses


def _solid(
    path: Path,
    shape: ElementTree.Element,
    read_mesh: ReadMesh,
    cache: dict[Path, trimesh.Trimesh],
) -> trimesh.Trimesh:
    """The solid of a ``visual`` or ``collision``, m."""
    geometry = shape.find("geometry")
    kind = None if geometry is None or len(geometry) == 0 else geometry[0]
    made: trimesh.Trimesh
    if kind is None:
        msg = f"{path}: a link's {shape.tag} has no geometry; correct it"
        raise ObjectError(msg)
    if kind.tag == "mesh":
        file = _mesh_file(path, kind.get("filename") or "")
        if file not in cache:
            cache[file] = read_mesh(file)
        scale = _numbers(path, kind, "scale", (1.0, 1.0, 1.0))
        made = cache[file].copy()
        made.vertices = made.vertices * scale
        if np.prod(scale) < 0:
            made.invert()
        return made
    sizes = {"box": 3, "sphere": 1, "cylinder": 2, "capsule": 2}
    if kind.tag not in sizes:
        known = ", ".join(["mesh", *sizes])
        msg = f"{path}: geometry <{kind.tag[:40]}> is not one of {known}"
        raise ObjectError(msg)
    if kind.tag == "box":
        size = _numbers(path, kind, "size")
    else:
        keys = ("radius", "length")[: sizes[kind.tag]]
        size = np.concatenate([_numbers(path, kind, key) for key in keys])
    if len(size) != sizes[kind.tag] or not (size > 0).all():
        msg = f"{path}: <{kind.tag}> has a size that is not above 0; correct it"
        raise ObjectError(msg)
    size = size * MM_PER_M  # trimesh takes corners for one that are 10 nm apart in its unit
    if kind.tag == "box":
        made = trimesh.creation.box(size)
    elif kind.tag == "sphere":
        made = trimesh.creation.uv_sphere(size[0], count=[SECTIONS // 2 + 1, SECTIONS])
    elif kind.tag == "cylinder":
        made = trimesh.creation.cylinder(size[0], size[1], sections=SECTIONS)
    else:
        made = trimesh.creation.capsule(size[1], size[0], count=[SECTIONS // 2, SECTIONS])
        made.apply_translation([0.0, 0.0, -made.bounds.mean(axis=0)[2]])
    return trimesh.Trimesh(made.vertices * M_PER_MM, made.faces, process=False)


def _mesh_file(path: Path, name: str) -> Path:
    """The file that a URDF's ``filename`` means: beside it, or in the package around it."""
    inner = re.sub(r"^(package|model|file)://", "", name)
    home = path.absolute().parent
    folders = [home, *home.parents][: FOLDERS_UP + 1]
    # The first folder of a package:// is the package itself, which may have another name here.
    tails = [inner, *([inner.partition("/")[2]] if "://" in name else [])]
    for folder in folders:
        for tail in filter(None, tails):
            found = folder / tail
            if found.is_file() and folders[-1].resolve() in found.resolve().parents:
                return found
    msg = f"{path}: its mesh {name[:200]!r} is not in its folders; put it beside the URDF"
    raise ObjectError(msg)


def _origin(path: Path, element: ElementTree.Element) -> NDArray[np.float64]:
    """The pose (4, 4) that ``<origin xyz rpy>`` states: turns about the fixed x, y and z."""
    pose, origin = np.eye(4), element.find("origin")
    if origin is not None:
        roll, pitch, yaw = _numbers(path, origin, "rpy", (0.0, 0.0, 0.0))
        pose = trimesh.transformations.euler_matrix(roll, pitch, yaw, "sxyz")
        pose[:3, 3] = _numbers(path, origin, "xyz", (0.0, 0.0, 0.0))
    return pose


def _numbers(
    path: Path, element: ElementTree.Element, key: str, default: tuple[float, ...] | None = None
) -> NDArray[np.float64]:
    """Numbers of an attribute; as many as the default has, which stands where it is missing."""
    text = element.get(key)
    if text is None and default is not None:
        return np.array(default)
    try:
        found = np.array([float(word) for word in (text or "").split()])
    except ValueError:
        found = np.array([])
    if not len(found) or len(found) != len(default or found) or not (abs(found) <= MOST).all():
        msg = f"{path}: <{element.tag} {key}={str(text)[:60]!r}> is not the numbers it takes"
        raise ObjectError(msg)
    return found
