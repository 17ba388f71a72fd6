"""A trained network on one's own images: the probability that the grasp will hold."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import logit

from tacgen.core.errors import LearningError
from tacgen.core.images import in_time_order
from tacgen.core.progress import print_status
from tacgen.core.safe_io import IMAGE_SUFFIXES, read_rgb
from tacgen.learning.checkpoint import load_model
from tacgen.learning.device import choose_device, exact_torch
from tacgen.learning.grasps import COMMANDED
from tacgen.learning.loader import as_batch
from tacgen.learning.network_input import (
    ARRAYS,
    VisionInput,
    chosen_frames,
    one_of,
    resized,
)
from tacgen.learning.predictions import (
    input_statistics,
    notes_on_images,
    notes_on_views,
    predict,
)
from tacgen.learning.run_folder import RunFolder
from tacgen.optics.same_view import GREY, SAME_VIEW, is_grey


class Predictor:
    """One model of the training run in the folder ``run``, ready for images.

    ``object_name`` chooses the model in a run with one an object. ``background_rgb`` (H, W, 3)
    uint8 is the gel at rest, with which images are compared; by default that of the training data.
    ``prior`` is the share of grasps that hold where the images were taken; by default that of the
    training grasps. Raises ``LearningError`` if the folder is not a run, ``prior`` is not between 0
    and 1, or which model to use is not clear.

    >>> tacgen.Predictor("run", object_name="can").predict(images)      # doctest: +SKIP
    array([0.93, 0.12])
    """

    def __init__(
        self,
        run: Path | str,
        object_name: str | None = None,
        background_rgb: NDArray[np.uint8] | None = None,
        device: str | None = None,
        prior: float | None = None,
    ) -> None:
        folder = RunFolder(run)
        options = folder.recipe().training
        self._device, self._threads = choose_device(options, device), options.threads
        plan = folder.plan()
        self._trained_s = plan["dataset"].get("taken_with", {}).get("time_s", [])
        name = _model_for(plan["models"], object_name, str(run))
        network, card, reference = load_model(folder.model(name).model_path)
        self._network, self.spec, self._card = network.to(self._device), card.input, card
        self._reference = self._trained = reference
        if prior is not None:
            if not 0 < prior < 1:
                msg = f"prior = {prior:g} is no share of grasps between 0 and 1"
                raise LearningError(msg)
            network.prior_logit = float(logit(prior))
        if background_rgb is not None:
            _check_size(background_rgb, self.spec.source_shape_px, "the background")
            self._reference = resized(background_rgb[None], self.spec.size_px)[0]

    def predict(
        self,
        images: NDArray[np.uint8] | Sequence[NDArray[np.uint8]],
        touch: Mapping[str, Sequence[NDArray[np.floating]]] | None = None,
        vision: NDArray[np.uint8] | Sequence[NDArray[np.uint8]] | None = None,
    ) -> NDArray[np.float64]:
        """Probability of success (N,) of each grasp.

        ``images`` are N of (H, W, 3) uint8 RGB, one a grasp, of the size that the network was
        trained on; for a sequence network N of (T, H, W, 3), the frames of each grasp in time
        order. ``touch`` holds what the network sees beside them, ``markers_mm`` (M, 2) or
        ``force_field_n`` (rows, columns, 3) of each image; of each grasp what was ``commanded``,
        (5,) as in a ``GraspConfig``, or the ``object``'s name; ``vision`` the camera's images of
        the same times, of a network that sees both (of one that sees a camera alone, ``images`` are
        the camera's). Raises ``LearningError`` if they are of another size or type, or missing.
        """
        inputs = [self._input(np.asarray(grasp), is_touch=self.spec.sees_touch) for grasp in images]
        if self.spec.vision is not None and self.spec.n_images == 2:
            seen = self._seen(images, vision, self.spec.vision)
            inputs = [np.concatenate(pair, axis=-1) for pair in zip(inputs, seen, strict=True)]
        beside = self._touch_of([np.asarray(grasp) for grasp in images], touch or {})
        counts, trained_s = {len(grasp) for grasp in images}, self._trained_s
        if self.spec.shows_until == "lift":
            if max(counts, default=0) > self.spec.n_frames:
                print_status(
                    f"the run was trained on {self.spec.frames_seen()}; give no later ones"
                )
        elif self.spec.kind == "sequence" and trained_s and counts - {len(trained_s)}:
            print_status(
                f"the run was trained on {len(trained_s)} frames over {trained_s[-1]:g} s of each "
                f"grasp, not {', '.join(map(str, sorted(counts)))}; give those of the same times"
            )
        unknown, rows = torch.zeros(1, dtype=torch.int64), np.zeros(1, np.int64)
        ref, plain = self._reference, replace(self.spec, normalised=False)
        pairs = list(zip(inputs, beside, strict=True))
        as_taken = [(as_batch([one], ref, plain, [t]), unknown, rows) for one, t in pairs]
        batches = ((as_batch([one], ref, self.spec, [t]), unknown, rows) for one, t in pairs)
        notes = notes_on_images(input_statistics(as_taken), self._card) if inputs else []
        if self.spec.sees_touch and inputs:
            notes += notes_on_views(inputs, ref, self._trained)
        for note in notes:
            print_status(note)
        with exact_torch(self._threads):
            return predict(self._network, batches, self._device)[0]

    @property
    def shape_px(self) -> tuple[int, int]:
        """The size of ``images``."""
        only = None if self.spec.sees_touch else self.spec.vision
        return self.spec.source_shape_px if only is None else only.shape_px

    def _seen(
        self,
        images: Sequence[NDArray[Any]] | NDArray[Any],
        vision: Sequence[NDArray[Any]] | NDArray[Any] | None,
        camera: VisionInput,
    ) -> list[NDArray[np.uint8]]:
        """What the camera saw of each grasp, in the frames that the network sees."""
        counts = [] if vision is None else [np.shape(grasp)[:-3] for grasp in vision]
        if counts != [np.shape(grasp)[:-3] for grasp in images]:
            msg = (
                f"the network also sees the camera {camera.camera!r}: give vision=…, one of its "
                f"images for each image of the {len(images)} grasps"
            )
            raise LearningError(msg)
        given = () if vision is None else vision
        return [self._input(np.asarray(grasp), is_touch=False) for grasp in given]

    def _touch_of(
        self, images: Sequence[NDArray[Any]], touch: Mapping[str, Sequence[NDArray[np.floating]]]
    ) -> list[list[NDArray[np.float32]]]:
        """Of each grasp the channels beside its images, in the frames that the network sees."""
        found: list[list[NDArray[np.float32]]] = [[] for _ in images]
        for channel in self.spec.touch:
            name = ARRAYS[channel.name]
            if name not in touch or len(touch[name]) != len(images):
                msg = (
                    f"the network also sees {name}, {channel.shape} of each image: give "
                    f'touch={{"{name}": …}} for the {len(images)} grasps'
                )
                raise LearningError(msg)
            for grasp, values, kept in zip(images, touch[name], found, strict=True):
                count = 1 if grasp.ndim == 3 else len(grasp)
                if channel.objects:
                    frames = one_of(channel.objects, str(values), count)
                else:
                    frames = np.asarray(values, np.float32)
                if frames.ndim == len(channel.shape):
                    frames = np.repeat(frames[None], count if name == COMMANDED else 1, axis=0)
                if frames.shape != (count, *channel.shape):
                    msg = f"{name} of a grasp is {frames.shape}, not {(count, *channel.shape)}"
                    raise LearningError(msg)
                if not np.isfinite(frames).all():
                    msg = f"{name} of a grasp has numbers that are not finite; give all of them"
                    raise LearningError(msg)
                kept.append(frames[chosen_frames(self.spec, count, 0)])
        return found

    def _input(self, grasp: NDArray[Any], *, is_touch: bool) -> NDArray[np.uint8]:
        """The frames of one grasp (t, h, w, 3) at the network's size."""
        frames, camera = grasp[None] if grasp.ndim == 3 else grasp, self.spec.vision
        shape_px = self.spec.source_shape_px if is_touch or camera is None else camera.shape_px
        if frames.ndim != 4 or not len(frames):
            msg = f"a grasp's images are (H, W, 3) or (T, H, W, 3), not {grasp.shape}"
            raise LearningError(msg)
        for frame in frames:
            _check_size(frame, shape_px, "an image")
        if self.spec.kind == "sequence" and len(frames) < 2:
            msg = "the run is of a sequence network: give two or more frames of each grasp"
            raise LearningError(msg)
        if self.spec.kind == "single" and len(frames) > 1:
            msg = f"the run is of a single-image network: give one image a grasp, not {len(frames)}"
            raise LearningError(msg)
        rest = self._reference if is_touch else None
        if rest is not None and any(is_grey(frame, rest) for frame in frames):
            msg = f"an image {GREY}, and the gel at rest is not; {SAME_VIEW}"
            raise LearningError(msg)
        return resized(frames[chosen_frames(self.spec, len(frames), 0)], self.spec.size_px)


def predict_files(predictor: Predictor, paths: Sequence[Path]) -> list[dict[str, str | float]]:
    """Probability of success for image files, or folders of them.

    For a network of single images every image is a grasp; for one of sequences those of a folder,
    or all that are given, in the order that the numbers in their names tell. Raises
    ``LearningError`` if a file is no image, a folder has none, or names have no one order.
    """
    sequence = predictor.spec.kind == "sequence"
    groups = [(path, _images_of(path, sequence=sequence)) for path in paths if path.is_dir()]
    loose = [path for path in paths if not path.is_dir()]
    if sequence:
        groups += [(loose[0], in_time_order(loose, LearningError))] if loose else []
    else:
        listed = dict(groups)
        groups = [(one, [one]) for path in paths for one in listed.get(path, [path])]
    images = [
        np.stack([_read_checked(path, predictor.shape_px) for path in files]) for _, files in groups
    ]
    return [
        {"images": str(path), "probability": float(p)}
        for (path, _), p in zip(groups, predictor.predict(images), strict=True)
    ]


def _read_checked(path: Path, shape_px: tuple[int, int]) -> NDArray[np.uint8]:
    image = read_rgb(path, LearningError)
    _check_size(image, shape_px, str(path))
    return image


def _images_of(folder: Path, *, sequence: bool = True) -> list[Path]:
    """The pictures in a folder in time order, which a network of sequences needs."""
    names = sorted(path for path in folder.iterdir() if path.is_file())
    found = [path for path in names if path.suffix.lower() in IMAGE_SUFFIXES]
    if not found:
        msg = f"{folder}: has no images ({', '.join(IMAGE_SUFFIXES)})"
        raise LearningError(msg)
    if len(found) < len(names):
        unused = ", ".join(path.name for path in names if path not in found)
        print_status(f"{folder}: not used, for they are no images: {unused}")
    try:
        return in_time_order(found, LearningError)
    except LearningError:
        if sequence:
            raise
        return found


def _model_for(models: dict[str, Any], object_name: str | None, run: str) -> str:
    """Name of the model for an object, or of the only one."""
    names = [name for name, model in models.items() if object_name in (None, *model["objects"])]
    if len(names) == 1:
        return names[0]
    objects = ", ".join(sorted({one for model in models.values() for one in model["objects"]}))
    msg = f"{run}: has models for {objects}; name one of these objects with --object"
    raise LearningError(msg)


def _check_size(image: NDArray[Any], shape_px: tuple[int, int], what: str) -> None:
    wanted = (*shape_px, 3)
    if image.dtype != np.uint8 or image.shape != wanted:
        msg = (
            f"{what} is {image.dtype} of shape {image.shape}; the network was trained on uint8 RGB "
            f"of shape {wanted}: use the same sensor and image size"
        )
        raise LearningError(msg)
