"""Datasets of simulated grasps: what a shard holds, writing, reading, checking and showing them."""

from tacgen.dataset.folder import DatasetFolder
from tacgen.dataset.reader import Dataset
from tacgen.dataset.samples import DatasetSpec, GraspSample, PadSample

__all__ = ["Dataset", "DatasetFolder", "DatasetSpec", "GraspSample", "PadSample"]
