"""The picture of a grasp: the object where it is, in its colour, the same bits every time."""

import numpy as np

from tacgen.collection.scene import PICTURE_PX, grasp_picture
from tacgen.core.records import ContactFrame, GraspConfig, GraspTrace
from tacgen.objects import load_object
from tacgen.physics.gripper import default_gripper

BOX = load_object("sugar_box")
CONFIG = GraspConfig(0, "sugar_box", 5.0, 0.0, 0.0, 90.0)


def trace(object_x_mm=0.0, opening_mm=20.0):
    """A grasp whose pads stand ``opening_mm`` from the gripper's centre."""
    gel_in_world = np.eye(4)
    gel_in_world[:3, 3] = -opening_mm, 0.0, 90.0
    object_in_world = np.eye(4)
    object_in_world[0, 3] = object_x_mm
    frame = ContactFrame(0.0, 5.0, np.zeros(2), 0.0, np.linalg.inv(gel_in_world) @ object_in_world)
    pose = np.array([[object_x_mm, 0, 0, 0, 0, 0, 1.0]])
    return GraspTrace(
        config=CONFIG, status="executed", label=1, frames={"left": (frame,)}, object_pose=pose,
        rise_mm=180.0, pad_distance_mm=np.full((1, 2), opening_mm),
    )  # fmt: skip


def coloured(picture):
    """Where the picture has the object's hue: yellow cardboard, far from grey."""
    wide = picture.astype(int)
    return wide.max(axis=-1) - wide.min(axis=-1) > 40


def test_the_picture_has_its_size_and_shows_the_object():
    picture = grasp_picture(BOX, CONFIG, trace(), 0, default_gripper())
    assert picture.shape == (*PICTURE_PX, 3)
    assert picture.dtype == np.uint8
    assert coloured(picture).mean() > 0.05


def test_an_object_that_moved_is_seen_elsewhere():
    def middle(object_x_mm):
        return np.argwhere(
            coloured(grasp_picture(BOX, CONFIG, trace(object_x_mm), 0, default_gripper()))
        ).mean(axis=0)

    assert np.linalg.norm(middle(40.0) - middle(0.0)) > 3


def test_a_pad_is_drawn_where_it_stands():
    """Fingers that lost their object go through each other in the physics; pads meet, drawn."""
    drawn = [
        grasp_picture(BOX, CONFIG, trace(400.0, opening_mm), 0, default_gripper())
        for opening_mm in (20.0, 0.0, -20.0)
    ]
    assert (drawn[0] != drawn[1]).any()
    np.testing.assert_array_equal(drawn[1], drawn[2])
