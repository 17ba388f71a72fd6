"""robomimic's file: what its loader indexes, and its own algorithms on it where it is installed."""

from __future__ import annotations

import importlib.util
import sys
import types

import h5py
import numpy as np
import pytest

from tacgen.dataset import Dataset
from tacgen.dataset.export import export_dataset

from .conftest import collect_toy, make_spec

OBSERVED = ["left_force_normal_n", "left_force_shear_n", "left_indentation_mm", "object_pose"]


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    root = tmp_path_factory.mktemp("robomimic")
    folder = collect_toy(root / "data", make_spec(pads=("left", "right")))
    folder.merge()
    export_dataset(folder.root, root / "out", "robomimic")
    return Dataset(folder.root), root / "out" / "grasps.hdf5"


def test_every_observation_has_an_axis_of_values_and_a_next_one(exported):
    dataset, path = exported
    with h5py.File(path) as file:
        indices = dataset.columns()["index"][dataset.columns()["label"] >= 0]
        assert len(file["data"]) == len(indices)
        for k, index in enumerate(indices):
            demo, pad = file[f"data/demo_{k}"], dataset.read(int(index)).pads["left"]
            assert set(demo["obs"]) == set(demo["next_obs"])
            for name, observed in demo["obs"].items():
                batch = np.stack([observed[:1]] * 4)  # (batch, sequence, …), as robomimic's loader
                assert batch[:, 0, :].shape == (4, *observed.shape[1:])
                later = np.concatenate([observed[1:], observed[-1:]])
                np.testing.assert_array_equal(demo["next_obs"][name], later)
            assert demo["obs/left_force_normal_n"].shape == (dataset.n_frames, 1)
            np.testing.assert_array_equal(demo["obs/left_force_normal_n"][:, 0], pad.force_normal_n)
            assert demo["obs/left_force_shear_n"].shape == (dataset.n_frames, 2)
            assert demo["obs/left_rgb"].shape == pad.rgb.shape


def test_nothing_in_it_tells_when_it_was_written(exported):
    with h5py.File(exported[1]) as file:
        objects = [file["/"]]
        file.visititems(lambda _, found: objects.append(found))
        assert any(isinstance(found, h5py.Dataset) and found.is_virtual for found in objects)
        assert not [found.name for found in objects if h5py.h5g.get_objinfo(found.id).mtime]


@pytest.fixture
def robomimic(monkeypatch):
    pytest.importorskip("torch")
    if importlib.util.find_spec("robomimic") is None:
        pytest.skip("robomimic is not installed: pip install --no-deps robomimic termcolor")
    if importlib.util.find_spec("torchvision") is None:  # its image encoders, which are not used
        functional = types.ModuleType("torchvision.transforms.functional")
        transforms = types.ModuleType("torchvision.transforms")
        transforms.Lambda = transforms.Compose = object
        transforms.functional = functional
        vision = types.ModuleType("torchvision")
        vision.transforms, vision.models = transforms, types.ModuleType("torchvision.models")
        parts = {"": vision, ".models": vision.models, ".transforms": transforms}
        parts[".transforms.functional"] = functional
        for name, module in parts.items():
            monkeypatch.setitem(sys.modules, f"torchvision{name}", module)
    import robomimic.algo

    return robomimic


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bc", "iql", "td3_bc"])
def test_robomimic_trains_an_epoch_on_it(robomimic, exported, name):
    import torch
    from robomimic.algo import algo_factory
    from robomimic.config import config_factory
    from robomimic.utils import file_utils, obs_utils, train_utils

    config = config_factory(name)
    with config.values_unlocked():
        config.train.data = str(exported[1])
        config.train.batch_size, config.train.num_data_workers = 4, 0
        config.train.cuda = False
        config.train.hdf5_load_next_obs = True
        config.observation.modalities.obs.low_dim = OBSERVED
        config.observation.modalities.obs.rgb = []
    config.lock()
    torch.manual_seed(0)
    obs_utils.initialize_obs_utils_with_config(config)
    shapes = file_utils.get_shape_metadata_from_dataset(
        dataset_path=config.train.data, all_obs_keys=config.all_obs_keys
    )
    model = algo_factory(name, config, shapes["all_shapes"], shapes["ac_dim"], torch.device("cpu"))
    data, _ = train_utils.load_data_for_training(config, obs_keys=shapes["all_obs_keys"])
    loader = torch.utils.data.DataLoader(data, batch_size=4, shuffle=True)
    found = train_utils.run_epoch(model=model, data_loader=loader, epoch=1)
    losses = [value for key, value in found.items() if "loss" in key.lower()]
    assert losses
    assert np.isfinite(losses).all()
