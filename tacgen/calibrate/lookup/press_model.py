"""Where a ball really is, told from where its label says it is, and the slopes that follow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tacgen.calibrate.lookup.samples import Pixels, place_mm
from tacgen.core.arrays import FloatArray
from tacgen.presses.geometry import (
    Membrane,
    press_height,
    press_slope,
    rest_height,
    rest_slope,
)
from tacgen.presses.press_images import PressImages

_TEN_MM = 10.0


@dataclass(frozen=True, slots=True)
class LabelModel:
    """What labels of centre and radius say about the true ones, learnt from the presses.

    Attributes
    ----------
    shift_mm : (3, 2) float
        Mean of (true − labelled centre) along x and y: a constant, and what it grows by in 10 mm
        along x and along y.
    contact_radius_mm, reference_radius_mm, radius_slope : float
        The expected contact radius is ``contact_radius_mm`` + ``radius_slope`` × (label −
        ``reference_radius_mm``): a slope below 1 where labels scatter more than the presses do.
    """

    shift_mm: NDArray[np.float64]
    contact_radius_mm: float
    reference_radius_mm: float
    radius_slope: float

    def geometry(self, label: FloatArray) -> FloatArray:
        """Expected centre and contact radius (..., 3) from labels (..., 3), mm."""
        ones = np.ones_like(label[..., 0])
        basis = np.stack([ones, label[..., 0] / _TEN_MM, label[..., 1] / _TEN_MM], axis=-1)
        radius = self.contact_radius_mm + self.radius_slope * (
            label[..., 2] - self.reference_radius_mm
        )
        return np.concatenate([label[..., :2] + basis @ self.shift_mm, radius[..., None]], axis=-1)


def learn_labels(labels: FloatArray, geometry: FloatArray) -> LabelModel:
    """The label model by least squares from labels (n, 3) and estimated geometry (n, 3), mm.

    The terms that grow with position are held back by a ridge worth half a press, so that a few
    presses close together do not tilt it.
    """
    basis = np.column_stack([np.ones(len(labels)), labels[:, :2] / _TEN_MM])
    ridge = np.diag([0.0, 0.5, 0.5])
    shift = np.linalg.solve(basis.T @ basis + ridge, basis.T @ (geometry - labels)[:, :2])
    reference = float(labels[:, 2].mean())
    spread = labels[:, 2] - reference
    slope = float(spread @ geometry[:, 2] / (spread @ spread + 1e-6 * reference**2))
    return LabelModel(
        shift_mm=shift,
        contact_radius_mm=float(geometry[:, 2].mean()),
        reference_radius_mm=reference,
        radius_slope=float(np.clip(slope, 0.0, 1.0)),
    )


@dataclass(frozen=True, slots=True)
class PressModel:
    """Everything besides the table that turns a label into a picture of a press."""

    labels: LabelModel
    membrane: Membrane
    dome_radius_mm: float = 0.0

    def slopes(
        self, geometry: FloatArray, ball_radius_mm: float, pixels: Pixels
    ) -> tuple[FloatArray, FloatArray]:
        """Slope of the gel at ``pixels`` around a ball at ``geometry`` (centre and radius, mm)."""
        added = press_slope(
            pixels.x_mm - geometry[0],
            pixels.y_mm - geometry[1],
            float(geometry[2]),
            ball_radius_mm,
            self.membrane,
            self.dome_radius_mm,
        )
        rest = rest_slope(pixels.x_mm, pixels.y_mm, self.dome_radius_mm)
        return added[0] + rest[0], added[1] + rest[1]

    def height(
        self, geometry: FloatArray, ball_radius_mm: float, x_mm: FloatArray, y_mm: FloatArray
    ) -> FloatArray:
        """Height of the gel, mm, at places on it around a ball at ``geometry``."""
        added = press_height(
            x_mm - geometry[0],
            y_mm - geometry[1],
            float(geometry[2]),
            ball_radius_mm,
            self.membrane,
            self.dome_radius_mm,
        )
        return added + rest_height(x_mm, y_mm, self.dome_radius_mm)

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, for a table's provenance."""
        return {
            "shift_mm": self.labels.shift_mm.tolist(),
            "contact_radius_mm": self.labels.contact_radius_mm,
            "reference_radius_mm": self.labels.reference_radius_mm,
            "radius_slope": self.labels.radius_slope,
            "decay_mm": self.membrane.decay_mm,
            "sharpness": self.membrane.sharpness,
            "dome_radius_mm": self.dome_radius_mm,
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> PressModel:
        """The inverse of ``as_dict``."""
        labels = LabelModel(
            shift_mm=np.asarray(values["shift_mm"], dtype=np.float64),
            contact_radius_mm=float(values["contact_radius_mm"]),
            reference_radius_mm=float(values["reference_radius_mm"]),
            radius_slope=float(values["radius_slope"]),
        )
        membrane = Membrane(float(values["decay_mm"]), float(values["sharpness"]))
        return cls(labels, membrane, float(values["dome_radius_mm"]))


def plain_press_model(contact_radius_mm: float, dome_radius_mm: float = 0.0) -> PressModel:
    """Labels taken at their word and a membrane that bends over 0.4 contact radii."""
    labels = LabelModel(np.zeros((3, 2)), contact_radius_mm, contact_radius_mm, 1.0)
    return PressModel(labels, Membrane(0.4 * contact_radius_mm, 4.0), dome_radius_mm)


def label_mm(presses: PressImages) -> FloatArray:
    """Labelled centre and radius (N, 3), mm on the gel from the image's centre."""
    x, y = place_mm(
        presses.center_px[:, 0], presses.center_px[:, 1], presses.shape_px, presses.mm_per_px
    )
    return np.column_stack([x, y, presses.radius_px * presses.mm_per_px])
