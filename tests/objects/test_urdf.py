"""URDFs of objects: links with their joints at zero as one rigid body, in metres."""

import numpy as np
import pytest
import trimesh

from tacgen.core.errors import ObjectError
from tacgen.objects.mesh_import import import_surface
from tacgen.objects.meshes import mass_properties, volume_mm3
from tests.messages import refused

LINK = """<link name="{name}"><visual><origin xyz="{xyz}" rpy="{rpy}"/>
<geometry>{shape}</geometry></visual></link>"""
JOINT = """<joint name="j_{child}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{xyz}" rpy="{rpy}"/></joint>"""
BASE = '<box size="0.04 0.03 0.06"/>'


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def link(name, shape, xyz="0 0 0", rpy="0 0 0"):
    return LINK.format(name=name, shape=shape, xyz=xyz, rpy=rpy)


def joint(parent, child, xyz="0 0 0", rpy="0 0 0", kind="fixed"):
    return JOINT.format(parent=parent, child=child, xyz=xyz, rpy=rpy, kind=kind)


def write(*elements, name="thing.urdf"):
    with open(name, "w", encoding="utf-8") as file:
        file.write(f'<robot name="r">{"".join(elements)}</robot>')
    return name


def test_links_are_where_their_joints_put_them():
    """A handle of 20 × 10 × 10 mm, turned by 90° about z and moved, on a box: in closed form."""
    path = write(
        link("base", BASE),
        link("arm", '<box size="0.02 0.01 0.01"/>', xyz="0.01 0 0"),
        joint("base", "arm", xyz="0 0.015 0.01", rpy="0 0 1.5707963267948966", kind="revolute"),
    )
    surface, notes = import_surface(path)
    assert volume_mm3(surface) == pytest.approx(40 * 30 * 60 + 20 * 10 * 10, rel=1e-6)
    center = mass_properties([(surface, 1.0)], 1.0)[0]
    # The arm lies along y, from 15 to 35 mm; the footprint's middle is at y = 10 mm.
    y = 2000.0 * 25.0 / 74_000.0 - 10.0
    z = 30.0 + 2000.0 * 10.0 / 74_000.0
    np.testing.assert_allclose(center, [0, y, z], atol=1e-3)
    assert notes[0] == "2 links are one rigid body, its 1 joints that move held at 0"


def test_meshes_beside_it_and_in_its_package(own_folder):
    (own_folder / "pkg" / "urdf").mkdir(parents=True)
    (own_folder / "pkg" / "meshes").mkdir()
    trimesh.creation.box((30.0, 40.0, 50.0)).export(own_folder / "pkg" / "meshes" / "part.stl")
    scale = 'scale="0.001 0.001 0.002"'
    for name in (
        "../meshes/part.stl",
        "package://pkg/meshes/part.stl",
        "package://x/meshes/part.stl",
    ):
        path = write(link("a", f'<mesh filename="{name}" {scale}/>'), name="pkg/urdf/a.urdf")
        assert volume_mm3(import_surface(path)[0]) == pytest.approx(120_000.0, rel=1e-5)
    mirrored = write(
        link("a", '<mesh filename="package://pkg/meshes/part.stl" scale="-.001 .001 .001"/>'),
        name="pkg/urdf/a.urdf",
    )
    surface, notes = import_surface(mirrored)
    assert volume_mm3(surface) == pytest.approx(60_000.0, rel=1e-5)
    assert notes == []


def test_a_link_without_visual_has_its_collision_shape():
    text = link("a", BASE).replace("visual", "collision")
    assert volume_mm3(import_surface(write(text))[0]) == pytest.approx(72_000.0, rel=1e-6)


@pytest.mark.parametrize(
    "elements",
    [
        [],
        [link("a", "")],
        [link("a", "<plane/>")],
        [link("a", '<box size="0.1 0.1"/>')],
        [link("a", '<box size="1 nan 1"/>')],
        [link("a", '<sphere radius="-1"/>')],
        [link("a", BASE, xyz="0 0")],
        [link("a", '<mesh filename="none.stl"/>')],
        [link("a", '<mesh filename="/etc/passwd"/>')],
        [link("a", '<mesh filename="../../../../../etc/passwd"/>')],
        [link("a", '<mesh filename="thing.urdf"/>')],
        [link("a", BASE), joint("a", "b")],
        [link("a", BASE), link("b", BASE), joint("a", "b"), joint("b", "a")],
        ["<!DOCTYPE r [<!ENTITY a 'aaaa'>]>"],
        ["<xacro:macro/>"],
        ["<a>"],
        [link("a", BASE)] * 1 + [link(f"b{k}", BASE) for k in range(1001)],
    ],
)
def test_what_is_no_object_is_refused_with_what_and_how(elements):
    with refused(ObjectError):
        import_surface(write(*elements))
