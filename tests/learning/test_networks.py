"""The networks are the published ones; pre-trained weights are read from where they should be."""

import builtins
import pickle
from collections import OrderedDict
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from tacgen.core.errors import LearningError
from tacgen.learning import backbone as backbone_module
from tacgen.learning.backbone import (
    Backbone,
    cached_imagenet_file,
    make_backbone,
    own_name,
    read_weights,
)
from tacgen.learning.networks import build_network, build_optimizer
from tacgen.learning.training_recipe import TrainingOptions
from tests.messages import refused

# Names and shapes of torchvision's resnet18, which its published weight file holds.
STAGES = {1: 64, 2: 128, 3: 256, 4: 512}


def torchvision_shapes() -> dict[str, tuple[int, ...]]:
    def norm(name: str, n: int) -> dict[str, tuple[int, ...]]:
        parts = ("weight", "bias", "running_mean", "running_var")
        return {f"{name}.{part}": (n,) for part in parts} | {f"{name}.num_batches_tracked": ()}

    shapes: dict[str, tuple[int, ...]] = {"conv1.weight": (64, 3, 7, 7), **norm("bn1", 64)}
    before = 64
    for stage, n in STAGES.items():
        for block in (0, 1):
            here = f"layer{stage}.{block}"
            shapes[f"{here}.conv1.weight"] = (n, before if block == 0 else n, 3, 3)
            shapes |= norm(f"{here}.bn1", n)
            shapes[f"{here}.conv2.weight"] = (n, n, 3, 3)
            shapes |= norm(f"{here}.bn2", n)
            if block == 0 and stage > 1:
                shapes[f"{here}.downsample.0.weight"] = (n, before, 1, 1)
                shapes |= norm(f"{here}.downsample.1", n)
        before = n
    return shapes | {"fc.weight": (1000, 512), "fc.bias": (1000,)}


@pytest.fixture(scope="module")
def torchvision_weights() -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    return {
        name: torch.rand(shape, generator=generator) + 0.5 if shape else torch.tensor(7)
        for name, shape in torchvision_shapes().items()
    }


def linears(module: nn.Module) -> list[tuple[int, int]]:
    return [(m.in_features, m.out_features) for m in module.modules() if isinstance(m, nn.Linear)]


def test_the_single_image_head_is_512_256_2_with_relu_and_dropout():
    head = build_network("single").head
    assert linears(head) == [(512, 256), (256, 2)]
    assert [type(layer) for layer in head] == [nn.Linear, nn.ReLU, nn.Dropout, nn.Linear]
    assert head[2].p == 0.2


def test_the_sequence_network_is_a_three_layer_lstm_of_128_and_a_head_of_128_64_2():
    network = build_network("sequence")
    assert (network.lstm.input_size, network.lstm.hidden_size) == (512, 128)
    assert network.lstm.num_layers == 3
    assert not network.lstm.bidirectional
    assert linears(network.head) == [(128, 64), (64, 2)]
    assert [type(layer) for layer in network.head] == [nn.Linear, nn.ReLU, nn.Dropout, nn.Linear]
    assert network.head[2].p == 0.2


def test_the_backbone_is_resnet_18():
    """The published 11 689 512 parameters without the classifier's 512 × 1000 + 1000."""
    backbone = Backbone()
    assert sum(p.numel() for p in backbone.parameters()) == 11_689_512 - 513_000
    assert backbone(torch.zeros(2, 3, 64, 96)).shape == (2, 512)


@pytest.mark.slow
def test_a_sequence_is_judged_by_the_last_hidden_state_of_features_in_order():
    network = build_network("sequence").eval()
    images = torch.rand(2, 4, 3, 32, 32)
    with torch.no_grad():
        features = torch.stack([network.backbone(images[:, k]) for k in range(4)], dim=1)
        _, (hidden, _) = network.lstm(features)
        expected = network.head(hidden[2])
        torch.testing.assert_close(network(images), expected, rtol=1e-4, atol=1e-5)
        assert not torch.allclose(network(images.flip(1)), expected, atol=1e-6)


def test_adam_gives_the_backbone_0_8_of_the_rate_and_decays_all_weights():
    network, options = build_network("single"), TrainingOptions()
    optimizer = build_optimizer(network, options)
    assert isinstance(optimizer, torch.optim.Adam)
    trunk, head = optimizer.param_groups
    assert (trunk["lr"], head["lr"]) == pytest.approx((0.8e-4, 1e-4))
    assert trunk["weight_decay"] == head["weight_decay"] == 5e-5
    assert {id(p) for p in trunk["params"]} == {id(p) for p in network.backbone.parameters()}
    everything = {id(p) for p in network.parameters()}
    assert {id(p) for p in (*trunk["params"], *head["params"])} == everything
    assert (options.batch_size, options.epochs) == (8, 30)


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".pth", ".safetensors"])
def test_a_local_weight_file_sets_every_layer(tmp_path, torchvision_weights, suffix):
    path = tmp_path / f"resnet18{suffix}"
    if suffix == ".pth":
        torch.save(OrderedDict(torchvision_weights), path)
    else:
        save_file(torchvision_weights, path)
    backbone = make_backbone(str(path))
    assert backbone.origin == str(path)
    own = backbone.network.state_dict()
    for name, value in torchvision_weights.items():
        if not name.startswith("fc."):
            torch.testing.assert_close(own[own_name(name)], value, msg=name)


def test_the_loaded_network_computes_what_resnet_18_computes(torchvision_weights, tmp_path):
    """Against the layers written out by hand with torch's functions, as published."""
    save_file(torchvision_weights, tmp_path / "w.safetensors")
    backbone = make_backbone(str(tmp_path / "w.safetensors")).eval()
    w = torchvision_weights
    f = nn.functional

    def norm(x, name):
        mean, var = w[f"{name}.running_mean"], w[f"{name}.running_var"]
        return f.batch_norm(x, mean, var, w[f"{name}.weight"], w[f"{name}.bias"])

    x = torch.rand(1, 3, 32, 32)
    y = f.relu(norm(f.conv2d(x, w["conv1.weight"], stride=2, padding=3), "bn1"))
    y = f.max_pool2d(y, 3, 2, 1)
    for stage in STAGES:
        for block in (0, 1):
            here, stride = f"layer{stage}.{block}", 2 if stage > 1 and block == 0 else 1
            z = f.conv2d(y, w[f"{here}.conv1.weight"], stride=stride, padding=1)
            z = f.relu(norm(z, f"{here}.bn1"))
            z = norm(f.conv2d(z, w[f"{here}.conv2.weight"], padding=1), f"{here}.bn2")
            if f"{here}.downsample.0.weight" in w:
                y = f.conv2d(y, w[f"{here}.downsample.0.weight"], stride=stride)
                y = norm(y, f"{here}.downsample.1")
            y = f.relu(y + z)
    with torch.no_grad():
        torch.testing.assert_close(backbone(x), y.mean((2, 3)), rtol=1e-3, atol=1e-3)


def test_imagenet_weights_left_by_torchvision_are_found(tmp_path, monkeypatch, torchvision_weights):
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    path = tmp_path / "checkpoints" / backbone_module.TORCHVISION_FILE
    path.parent.mkdir()
    torch.save(OrderedDict(torchvision_weights), path)
    for weights in ("imagenet", "auto"):
        assert make_backbone(weights).origin == f"imagenet ({path.name})"


def test_imagenet_weights_in_the_hub_cache_are_found(tmp_path, monkeypatch):
    from huggingface_hub import constants

    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path / "none"))
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path))
    repo = tmp_path / "models--microsoft--resnet-18"
    (repo / "refs").mkdir(parents=True)
    (repo / "refs" / "main").write_text("abc")
    (repo / "snapshots" / "abc").mkdir(parents=True)
    given = {f"resnet.{name}": v for name, v in Backbone().network.state_dict().items()}
    path = repo / "snapshots" / "abc" / "model.safetensors"
    save_file(given | {"classifier.1.bias": torch.zeros(1000)}, path)
    assert cached_imagenet_file() == path
    assert make_backbone("imagenet").origin == "imagenet (model.safetensors)"


def test_without_imagenet_weights_auto_says_none_and_imagenet_stops(monkeypatch):
    monkeypatch.setattr(backbone_module, "cached_imagenet_file", lambda: None)
    assert make_backbone("auto").origin == "none"
    with refused(LearningError):
        make_backbone("imagenet")


@pytest.mark.slow
def test_weights_that_are_not_a_resnet_18_are_refused(tmp_path, torchvision_weights):
    for weights in (
        {k: v for k, v in torchvision_weights.items() if k != "layer3.1.conv2.weight"},
        torchvision_weights | {"layer1.2.conv1.weight": torch.zeros(64, 64, 3, 3)},
        torchvision_weights | {"layer1.0.conv1.weight": torch.zeros(64, 64, 1, 1)},
    ):
        path = tmp_path / "w.safetensors"
        save_file(weights, path)
        with refused(LearningError):
            make_backbone(str(path))
    with refused(LearningError):
        make_backbone(str(tmp_path / "nowhere.pth"))


class Harmful:
    def __reduce__(self) -> tuple:
        return (builtins.exec, ("raise SystemExit('code of the file was run')",))


def test_a_weight_file_with_code_in_it_is_refused_without_running_it(tmp_path):
    path = tmp_path / "weights.pth"
    path.write_bytes(pickle.dumps({"conv1.weight": Harmful()}))
    with refused(LearningError):
        read_weights(path)
    torch.save({"conv1.weight": Harmful()}, path)
    with refused(LearningError):
        read_weights(path)


@pytest.mark.parametrize("content", [b"", b"not a file of weights", b"\x80\x04K\x01."])
def test_a_damaged_weight_file_is_told(tmp_path: Path, content: bytes):
    for name in ("w.pth", "w.safetensors"):
        (tmp_path / name).write_bytes(content)
        with refused(LearningError):
            read_weights(tmp_path / name)
