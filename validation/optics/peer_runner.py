"""Runs one peer on presses and prints its times; in the peer's own environment, without tacgen."""

import json
import os
import sys
import timeit
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

Presses = Mapping[str, Any]
Times = dict[str, list[float]]


def least_ms(action: Callable[[], object], repeats: int) -> float:
    """The least time of an action, after one that is not counted."""
    action()
    return 1e3 * min(timeit.repeat(action, number=1, repeat=repeats))


def taxim(folder: Path, presses: Presses, repeats: int) -> Times:
    """Deformation and image of Taxim's ``simulator``; the object that it loads is not used."""
    os.chdir(folder / "OpticalSimulation")
    sys.path.insert(0, os.getcwd())
    sys.argv = ["simOptical.py"]
    import_module("cv2").setNumThreads(1)
    simulator = import_module("simOptical").simulator
    sim = simulator("../calibs", "../data/objects", "square.ply")
    times: Times = {"plain": [], "shadows": []}
    for depth_mm in presses["depth_mm"]:
        raised_px = depth_mm / float(presses["mm_per_px"])
        touched, deepest_mm = depth_mm > 0, float(depth_mm.max())

        def image(
            shadow: bool, raised_px: Any = raised_px, touched: Any = touched, mm: float = deepest_mm
        ) -> object:
            deformed = sim.deformApprox(mm, raised_px, np.zeros_like(raised_px), touched)
            return sim.simulating(*deformed, shadow=shadow)

        times["plain"].append(least_ms(partial(image, False), repeats))
        times["shadows"].append(least_ms(partial(image, True), max(2, repeats // 10)))
    return times


def fots(folder: Path, presses: Presses, repeats: int) -> Times:
    """FOTS's ``generate``: smoothing, network and image."""
    os.chdir(folder)
    sys.path[:0] = [str(folder), str(folder / "mlp_calib")]
    torch: Any = import_module("torch")
    torch.set_num_threads(1)
    torch.load = partial(torch.load, map_location="cpu")  # its network was saved on a GPU
    import_module("cv2").setNumThreads(1)
    generate = import_module("tactile_render").get_simapproach().generate
    times: Times = {"plain": [], "shadows": []}
    for depth_mm in presses["depth_mm"]:
        given = depth_mm / float(presses["mm_per_px"]), depth_mm > 0
        times["plain"].append(least_ms(partial(generate, *given, shadow=False), repeats))
        times["shadows"].append(least_ms(partial(generate, *given, shadow=True), repeats))
    return times


def tacto(folder: Path, presses: Presses, repeats: int) -> Times:
    """TACTO's ``Renderer`` of its DIGIT, from the mesh; the gel's z is its x."""
    sys.path.insert(0, str(folder))
    make_mesh = import_module("trimesh").Trimesh
    height, width = presses["depth_mm"].shape[1:]
    config = str(folder / "tacto" / "config_digit.yml")
    renderer = import_module("tacto.renderer").Renderer(width, height, None, config)
    gel_m = np.array([float(value) for value in renderer.conf.sensor.gel.origin])
    times: Times = {"plain": []}
    for k in range(len(presses["depth_mm"])):
        vertices_m = presses[f"vertices_mm_{k}"][:, [2, 0, 1]] * 1e-3 + gel_m
        renderer.add_object(make_mesh(vertices_m, presses[f"faces_{k}"]), f"press{k}")
        times["plain"].append(least_ms(renderer.render, repeats))
        renderer.scene.remove_node(renderer.object_nodes.pop(f"press{k}"))
    return times


if __name__ == "__main__":
    name, folder_name, path, count = sys.argv[1:]
    with np.load(path) as file:
        loaded = dict(file)
    run = {"Taxim": taxim, "FOTS": fots, "tacto": tacto}[name]
    sys.stdout.write(json.dumps(run(Path(folder_name), loaded, int(count))) + "\n")
