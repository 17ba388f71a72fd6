"""Position: the gel gives more in one place than in another."""

import numpy as np

from tacgen.contact.effects import base

PLACE = ("x_mm", "y_mm")
TERMS = ("x", "y", "xx", "xy", "yy")
GRID = np.linspace(-1.0, 1.0, 5)
SPOTS = (-0.5, 0.0, 0.5)
"""Where along each axis, in extents, the fit of a spot starts."""
BUMPS = base.free_amounts("bump", GRID.size**2)
"""Amounts of Gaussians on a grid, as far apart as they are wide: half the extent."""


def _apply(load: base.FloatArray, history: base.LoadHistory, p: base.Parameters) -> base.FloatArray:
    """Gain 1 + a polynomial of second degree in u = x/extent and v = y/extent + a Gaussian spot.

    Free amounts add a smooth function of any shape.
    """
    u = np.clip(history.column("x_mm") / p["extent_mm"], -1.2, 1.2)
    v = np.clip(history.column("y_mm") / p["extent_mm"], -1.2, 1.2)
    relative = p["rr"] * (u**2 + v**2)
    for name in TERMS:
        if p[name] != 0.0:
            relative = relative + p[name] * u ** name.count("x") * v ** name.count("y")
    if p["spot"] != 0.0:
        away_mm = np.hypot(
            history.column("x_mm") - p["spot_x_mm"], history.column("y_mm") - p["spot_y_mm"]
        )
        relative = relative + p["spot"] * np.exp(-0.5 * (away_mm / p["spot_width_mm"]) ** 2)
    bumps = np.array([p[one.name] for one in BUMPS]).reshape(GRID.size, GRID.size)
    if bumps.any():
        along_x, along_y = (np.exp(-0.5 * ((w[:, None] - GRID) / 0.5) ** 2) for w in (u, v))
        relative = relative + ((along_x @ bumps) * along_y).sum(axis=1)
    return base.with_gain(load, relative)


def _references(history: base.LoadHistory) -> dict[str, float]:
    """The largest finite |x| or |y|; 1 for an axis that has none above 0."""
    sizes = (np.abs(history.column(name)) for name in PLACE)
    return {
        "extent_mm": max(
            float(size.max(where=np.isfinite(size), initial=0.0)) or 1.0 for size in sizes
        )
    }


def _variants(history: base.LoadHistory, references: base.Parameters) -> tuple[base.Variant, ...]:
    forms = {
        "along x": ("x",),
        "along y": ("y",),
        "plane": ("x", "y"),
        "from the centre out": ("rr",),
        "from any place out": ("x", "y", "rr"),
        "second degree": TERMS,
    }
    extent_mm = references["extent_mm"]
    spots = [
        {"spot_x_mm": x * extent_mm, "spot_y_mm": y * extent_mm, "spot_width_mm": 0.4 * extent_mm}
        for x in SPOTS
        for y in SPOTS
    ]
    return (
        *(base.variant(k, [{name: 0.05} for name in names]) for k, names in forms.items()),
        *(
            base.variant(
                "a spot around {spot_x_mm:.2g}, {spot_y_mm:.2g} mm".format(**one),
                [{"spot": 0.05}],
                one,
            )
            for one in spots
        ),
    )


base.register(
    base.Effect(
        name="position",
        channel="normal",
        stage="gain",
        is_of_trials=True,
        about="the compliance depends on where the gel is touched",
        parameters=(
            *(base.amount(name, -5.0, 5.0) for name in (*TERMS, "rr", "spot")),
            *(
                base.shape(name, -1e3, 1e3, 0.0, "mm", base.share_of("extent_mm", -1.0, 1.0))
                for name in ("spot_x_mm", "spot_y_mm")
            ),
            base.shape(
                "spot_width_mm", 1e-3, 1e3, 1.0, "mm", base.share_of("extent_mm", 0.15, 1.5)
            ),
            *BUMPS,
            base.reference("extent_mm", "mm"),
        ),
        apply=_apply,
        references=_references,
        variants=_variants,
        needs=PLACE,
        is_identifiable=lambda history: any(base.varies(history.column(n)) for n in PLACE),
        shown_against="x_mm",
        separated_by={"geometry": "press every ball at the same places"},
    )
)
