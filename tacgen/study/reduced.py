"""What the reduced version of a study has less of."""

from __future__ import annotations

from collections.abc import Sequence

from tacgen.study.study_recipe import Row, Study


def reductions(study: Study, rows: Sequence[Row]) -> list[str]:
    """What ``--quick`` changes of these rows, such as ``epochs: 15 instead of 30``."""
    whole = [_figures(study, row, quick=False) for row in rows]
    quick = [_figures(study, row, quick=True) for row in rows]
    told: dict[str, list[str]] = {}
    for before, after in zip(whole, quick, strict=True):
        for name, figure in after.items():
            text = f"{figure} instead of {before[name]}"
            if figure != before[name] and text not in told.setdefault(name, []):
                told[name].append(text)
    return [f"{name}: {', '.join(texts)}" for name, texts in told.items() if texts]


def _figures(study: Study, row: Row, *, quick: bool) -> dict[str, str]:
    data, train = study.data_recipe(row, quick=quick), study.train_recipe(row, quick=quick)
    height, width = train.input.size_px
    return {
        "objects": str(len(data.objects)),
        "frames": str(data.frames.count if data.frames.mode == "sequence" else 1),
        "sampled grasps": str(data.grid.sample or "all"),
        "training grasps": str(train.training.grasps or "all"),
        "input": f"{width}×{height} px",
        "epochs": str(train.training.epochs),
    }
