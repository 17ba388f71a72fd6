"""Datasets of simulated grasps: what a shard holds, writing, reading, checking and showing them."""

from tacgen.dataset.folder import DatasetFolder
from tacgen.dataset.reader import Dataset
from tacgen.dataset.samples import CameraSample, DatasetSpec, GraspSample, PadSample

__all__ = [
    "CameraSample",
    "Dataset",
    "DatasetFolder",
    "DatasetSpec",
    "GraspSample",
    "PadSample",
]
