"""Pictures of the reports with numbered parts: docs/figures/report_*.webp, each under 100 kB.

    python -m docs.report_pictures FOLDER

FOLDER holds the reports that ``COMMANDS`` make; where it is missing they run, for a quarter of an
hour. Chromium (``chromium``) takes the pictures; ``reference/reports.md`` explains the numbers.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

FIGURES, MAX_KB = Path(__file__).parent / "figures", 100
TUTORIAL = Path(__file__).parent / "tutorial" / "first_network.md"
WRONG_RECIPE = """
extends: recipe.yaml
name: wrong_friction
objects: [{name: tomato_soup_can, friction: 0.25}]
"""
COMMANDS = """
tacgen collect quickstart --out quick
tacgen rig session.yaml --out session
tacgen calibrate lookup session/presses --out table.npz --report report_lookup
tacgen calibrate contact session/press_log.csv --out contact.yaml
tacgen rig rig --out clean
tacgen calibrate contact clean/press_log.csv --out clean.yaml --report report_contact
tacgen rig rig_two_effects --out two
tacgen diagnose contact two/press_log.csv --out diagnosis
tacgen diagnose optics dimmer --table table.npz --out optics
tacgen collect recipe.yaml --out data
tacgen train train_single_small --data data --out run
tacgen eval run --data data
tacgen export data --format real-grasps --out grasps --no-images
tacgen friction recipe.yaml --real grasps --out friction --mu 0.2:0.6:0.1
tacgen diagnose grasps grasps --recipe wrong_recipe.yaml --out grasp_diagnosis
"""
REPORTS: dict[str, tuple[str, Sequence[str]]] = {
    "gallery": (
        "quick/index.html",
        ("grasps", "Outcome by object", "Outcome by gripping force", "Contact force and outcome",
         "force", "tomato soup can</b>", "grip"),
    ),
    "lookup": (
        "report_lookup/index.html",
        ("Held-out presses", "Error of each held-out press", "Fit and residual", "Scale and balls",
         "What to press next"),
    ),
    "contact": (
        "report_contact/index.html",
        ("Normal: fit and residual", "Normal: k_n by indenter", "Normal: error of held-out presses",
         "Warnings", "What to press next"),
    ),
    "diagnosis_contact": (
        "diagnosis/report.html",
        ("Error before and after", "Normal channel: residual before and after",
         "Normal channel: accepted effects and unexplained covariates",
         "Normal channel: ranking of candidates"),
    ),
    "diagnosis_optics": (
        "optics/report.html",
        ("Error before and after", "Test presses", "Effects, in the order in which they were added",
         "Candidates at each step", "What these presses cannot determine, and which could"),
    ),
    "diagnosis_grasps": (
        "grasp_diagnosis/report.html",
        ("tomato_soup_can", "Mislabels before and after", "Each candidate alone",
         "Explanations, together", "Real grasps to make next"),
    ),
    "friction": ("friction/index.html", ("tomato_soup_can</h2>", "Friction by object")),
    "training": (
        "run/models/tomato_soup_can/index.html",
        ("Curves", "Validation grasps: confusion", "Validation grasps: scores", "What was trained"),
    ),
    "evaluation": (
        "run/index.html",
        ("Confusion", "Calibration", "Overall", "By force", "Misclassified grasps"),
    ),
}  # fmt: skip
"""By picture: the report, and the texts that get a number; sections without one are left out."""
WIDTH_PX = 900
_STYLE = f"""<style>
.doc-label {{ display: inline-block; flex: none; width: 1.5em; height: 1.5em; margin-right: .4em;
  background: #d1242f; border-radius: 50%; color: white; font: bold 15px/1.5em sans-serif;
  text-align: center; }}
section:not(.plots) {{ max-height: 400px; overflow: hidden; }}
.cards .card:nth-child(n+3) {{ display: none; }}
body {{ width: {WIDTH_PX}px; }}
</style>"""


def main(folder: Path) -> None:
    """Write every picture."""
    if not folder.exists():
        _make_reports(folder)
    for name, (report, parts) in REPORTS.items():
        html = numbered((folder / report).read_text(encoding="utf-8"), parts)
        print(_save(_photo(html), FIGURES / f"report_{name}.webp"))  # noqa: T201


def _make_reports(folder: Path) -> None:
    folder.mkdir(parents=True)
    files = re.findall(r'```yaml title="(.+?)"\n(.*?)```', TUTORIAL.read_text("utf-8"), re.S)
    for name, content in [*files, ("wrong_recipe.yaml", WRONG_RECIPE)]:
        (folder / name).write_text(content, encoding="utf-8")
    for command in COMMANDS.strip().splitlines():
        if "dimmer" in command:
            _dim(folder / "session" / "presses", folder / "dimmer")
        subprocess.run([sys.executable, "-m", *command.split()], cwd=folder, check=True)
        if "export" in command:  # 60 grasps: what a person may have, and a fraction of the time
            grasps = folder / "grasps" / "grasps.csv"
            lines = grasps.read_text("utf-8").splitlines(keepends=True)
            grasps.write_text("".join(lines[:61]), "utf-8")


def _dim(presses: Path, out: Path) -> None:
    """The same presses with a tenth less exposure, but for the background."""
    shutil.copytree(presses, out)
    for path in out.glob("**/press_*.png"):
        pixels = 0.9 * np.asarray(Image.open(path).convert("RGB"), np.float64)
        Image.fromarray(pixels.round().astype(np.uint8)).save(path)


def numbered(html: str, parts: Sequence[str]) -> str:
    """A page with a number before each of ``parts``, and without sections that have none."""

    def kept(found: re.Match[str]) -> str:
        shown = any(f">{part}" in found[0] for part in parts)
        return found[0] if shown or "<h2>" not in found[0] else ""

    html = re.sub(r"<section.*?</section>", kept, html, flags=re.S)
    for number, part in enumerate(parts, 1):
        if f">{part}" not in html:
            msg = f"no {part!r} in the report; correct REPORTS"
            raise ValueError(msg)
        html = html.replace(f">{part}", f'><span class="doc-label">{number}</span>{part}', 1)
    return html.replace("</head>", f"{_STYLE}</head>")


def _photo(html: str) -> Image.Image:
    """The page as Chromium draws it, cut where it ends."""
    with tempfile.TemporaryDirectory() as folder:
        page, picture = Path(folder, "page.html"), Path(folder, "page.png")
        page.write_text(html, encoding="utf-8")
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars",
                   "--disable-background-networking", f"--user-data-dir={folder}/profile",
                   "--virtual-time-budget=3000", f"--window-size={WIDTH_PX},2600",
                   f"--screenshot={picture}"]  # fmt: skip
        subprocess.run(["chromium", *options, page.as_uri()], check=True, capture_output=True)
        with Image.open(picture) as opened:
            shown = opened.convert("RGB")
    rows = np.flatnonzero(np.ptp(np.asarray(shown)[:, :, 0], axis=1) > 0)
    return shown.crop((0, 0, WIDTH_PX, min(int(rows[-1]) + 20, shown.height)))


def _save(picture: Image.Image, path: Path) -> str:
    """Write a picture, as well as its size allows; returns its size."""
    for quality in (80, 60, 40):
        picture.save(path, quality=quality, method=6)
        size_kb = path.stat().st_size / 1000
        if size_kb <= MAX_KB:
            return f"{path.name}: {size_kb:.0f} kB"
    msg = f"{path}: {size_kb:.0f} kB, more than {MAX_KB}; show fewer sections"
    raise ValueError(msg)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
