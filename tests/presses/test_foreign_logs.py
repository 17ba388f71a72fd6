"""Logs of laboratories that nobody here tuned on: the same presses, or a refusal that mends them.

Every case is one file of the same eight presses (k_n = 5) as some program writes it.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tacgen.calibrate.contact.command import LogSource, calibrate_contact
from tacgen.core.errors import PressError
from tacgen.diagnose.contact.command import diagnose_log
from tacgen.presses.geometry import ball_volume_mm3
from tacgen.presses.lab_table import LogFormat
from tacgen.presses.press_log import read_press_log

K_N, RADIUS_MM, N_PRESSES = 5.0, 4.0, 8
STANDARD_GRAVITY = 9.80665
POUND_N = 4.4482216152605


def presses() -> pd.DataFrame:
    """Presses of a ball with a rest before and after each, one clock with pauses between them."""
    rng = np.random.default_rng(11)
    parts, start_s = [], 0.0
    for trial in range(1, N_PRESSES + 1):
        up = np.linspace(0.0, 1.0, 25)
        depth = rng.uniform(0.5, 1.1) * np.concatenate([np.zeros(5), up, up[::-1], np.zeros(5)])
        volume = ball_volume_mm3(depth, RADIUS_MM)
        force = volume / K_N + 0.004 * rng.standard_normal(len(depth))
        time_s = start_s + 0.08 * np.arange(len(depth))
        start_s = time_s[-1] + 12.0
        columns = {"trial": trial, "t": time_s, "F": force, "d": depth, "V": volume}
        parts.append(pd.DataFrame(columns))
    return pd.concat(parts, ignore_index=True).round(5)


def named(frame: pd.DataFrame, *headers: str) -> pd.DataFrame:
    """Its press, time, force and depth under other headers."""
    return frame[["trial", "t", "F", "d"]].set_axis(headers, axis=1)


def plain(frame: pd.DataFrame, **options: object) -> str:
    return named(frame, "Trial", "Time", "Force", "Depth").to_csv(index=False, **options)


def some(frame: pd.DataFrame, **headers: str) -> str:
    """Some of its columns, by their headers."""
    return frame[[*headers]].rename(columns=headers).to_csv(index=False)


def with_volume(frame: pd.DataFrame, *headers: str, **options: object) -> str:
    return frame[["trial", "t", "F", "V"]].set_axis(headers, axis=1).to_csv(index=False, **options)


def german(frame: pd.DataFrame, *headers: str) -> str:
    return named(frame, *headers).to_csv(index=False, sep=";", decimal=",")


def thousands(frame: pd.DataFrame, mark: str, decimal: str, *headers: str, digits: int = 1) -> str:
    """Times in ms and depths in µm with marks between thousands."""

    def text(value: float) -> str:
        whole = f"{value:,.{digits}f}".replace(",", "_").replace(".", decimal)
        return whole.replace("_", mark)

    made = named(frame, *headers).astype(object)
    for header, factor in zip(headers[1:], (1e3, 1.0 if digits else 1e3, 1e3), strict=True):
        exact = digits == 1 and factor == 1.0
        values = made[header].astype(float) * factor
        made[header] = [str(v).replace(".", decimal) if exact else text(v) for v in values]
    return made.to_csv(index=False, sep=";")


def blocks(frame: pd.DataFrame, header: str, between: str = "") -> str:
    """Each press below its own header or blank line."""
    parts = [part[["t", "F", "d"]] for _, part in frame.groupby("trial")]
    texts = [part.to_csv(index=False, header=False) for part in parts]
    return header + (between or f"\n{header}").join(texts)


def stamped(frame: pd.DataFrame, style: str) -> pd.DataFrame:
    time = pd.Timestamp("2026-03-01T11:59:30") + pd.to_timedelta(frame["t"], unit="s")
    return frame.assign(t=time.dt.strftime(style))


def holes(frame: pd.DataFrame, text: str) -> str:
    """Every 61st force is not there: the columns of a few cells that a program writes."""
    made = frame.astype({"F": object})
    made.loc[::61, "F"] = text
    return plain(made)


def formulas(frame: pd.DataFrame) -> str:
    cells = named(frame, "Trial", "Time", "Force", "Depth").astype(str)
    return cells.apply(lambda column: '="' + column + '"').to_csv(index=False)


def aligned(frame: pd.DataFrame) -> str:
    return named(frame, "Trial", "Time", "Force", "Depth").to_string(index=False)


def numpy_header(frame: pd.DataFrame) -> str:
    file = io.StringIO()
    header = "Trial\tTime [s]\tForce [N]\tDepth [mm]"
    np.savetxt(file, frame[["trial", "t", "F", "d"]], delimiter="\t", header=header, fmt="%.8g")
    return file.getvalue()


def two_unit_rows(frame: pd.DataFrame) -> str:
    rows = frame[["t", "F", "d", "trial"]].to_csv(index=False, header=False, sep=";", decimal=",")
    return f"Prüfzeit;Standardkraft;Standardweg;Zyklus\ns;N;mm;\n{rows}"


def titled_blocks(frame: pd.DataFrame) -> str:
    head = '"Time","Load","Extension"\n"(s)","(N)","(mm)"\n'
    return blocks(frame, f'"Specimen 1"\n{head}', f'\n"Specimen 2"\n{head}')


def labview(frame: pd.DataFrame) -> str:
    """A .lvm file: two headers of keys and values, as many cells as the rows have, or more."""
    rows = frame[["t", "F", "d"]].to_csv(index=False, header=False, sep="\t", decimal=",")
    return (
        "LabVIEW Measurement\t\nWriter_Version\t2\nDecimal_Separator\t,\nX_Columns\tOne\n"
        "***End_of_Header***\t\n\t\nChannels\t2\t\t\nSamples\t480\t480\t\n"
        "Date\t2024/03/05\t2024/03/05\t\nX_Dimension\tTime\tTime\t\n***End_of_Header***\t\t\t\t\n"
        f"Time\tForce\tDepth\tComment\n{rows}"
    )


def with_summary(frame: pd.DataFrame) -> str:
    lines = [f"{word},,{frame['F'].mean():.3f},{frame['d'].mean():.3f}" for word in ("Mean", "Max")]
    return plain(frame) + "\n".join([*lines, "", "Operator: Ann, lab 3"])


def spikes(frame: pd.DataFrame) -> str:
    made = frame.copy()
    made.loc[[30, 200], "F"] = (-999.0, 9999.0)
    return plain(made)


def in_units(frame: pd.DataFrame, force: float = 1.0, depth: float = 1.0, time: float = 1.0):
    factors = {"F": force, "d": depth, "t": time}
    return frame.assign(**{name: frame[name] * by for name, by in factors.items()})


READ: dict[str, tuple[Callable[[pd.DataFrame], str | bytes], list[str]]] = {
    "German headers": (lambda f: german(f, "Versuch Nr.", "Zeit (s)", "Kraft (N)", "Weg (mm)"), []),
    "German units, Windows": (
        lambda f: german(in_units(f, 1e3, 1e3), "Prüfung", "Zeit/s", "Kraft/mN", "Tiefe/µm").encode(
            "cp1252"
        ),
        [],
    ),
    "French, UTF-16": (
        lambda f: german(f, "N° essai", "Temps [s]", "Effort [N]", "Enfoncement [mm]").encode(
            "utf-16"
        ),
        [],
    ),
    "UTF-16 without its mark": (lambda f: plain(f, sep="\t").encode("utf-16-le"), []),
    "Spanish": (lambda f: german(f, "Ensayo", "Tiempo (s)", "Fuerza (N)", "Profundidad (mm)"), []),
    "camel case": (
        lambda f: named(f, "trialId", "timestampSec", "forceN", "depthMm").to_csv(index=False),
        [],
    ),
    "capitals": (
        lambda f: named(f, "TRIAL", "TIME [S]", "FORCE [N]", "DEPTH [MM]").to_csv(index=False),
        [],
    ),
    "units in words": (
        lambda f: named(
            in_units(f, 1e3),
            "trial",
            "time (seconds)",
            "force (millinewtons)",
            "depth (millimeters)",
        ).to_csv(index=False),
        [],
    ),
    "kN of a testing machine": (
        lambda f: named(
            in_units(f, 1e-3), "Cycle", "Test time [s]", "Standard force [kN]", "Stroke [mm]"
        ).to_csv(index=False),
        [],
    ),
    "pounds and inches": (
        lambda f: named(
            in_units(f, 1 / POUND_N, 1 / 25.4), "Test", "Time (s)", "Load (lbf)", "Extension (in)"
        ).to_csv(index=False),
        [],
    ),
    "kilograms": (
        lambda f: named(
            in_units(f, 1 / STANDARD_GRAVITY), "Run", "t [s]", "Load [kg]", "Displacement [mm]"
        ).to_csv(index=False),
        [],
    ),
    "microns and microseconds": (
        lambda f: named(in_units(f, 1e6, 1e6, 1e6), "run", "t [us]", "F [µN]", "depth [nm]").to_csv(
            index=False
        ),
        [],
    ),
    "units in the cells": (
        lambda f: plain(
            f.assign(**{k: [f"{v} {u}" for v in f[k]] for k, u in {"F": "N", "d": "mm"}.items()})
        ),
        [],
    ),
    "units in a row": (two_unit_rows, []),
    "LabVIEW": (labview, []),
    "keys and values above": (
        lambda f: (
            "Operator;Ann;Lab 3\nGel;12;soft\nRate;5;mm/min\n"
            + f[["t", "F", "d"]]
            .set_axis(["Time", "Force", "Depth"], axis=1)
            .to_csv(index=False, sep=";")
        ),
        [],
    ),
    "headers on two lines of a cell": (
        lambda f: named(f, "Trial\nNo.", "Time\n[s]", "Force\n[N]", "Depth\n[mm]").to_csv(
            index=False
        ),
        [],
    ),
    "quotes after spaces": (
        lambda f: plain(f, decimal=",", quoting=csv.QUOTE_ALL).replace('","', '", "'),
        [],
    ),
    "a quote in a comment": (lambda f: plain(f).replace("\n2,", '\n# gel,"soft\n2,', 1), []),
    "Excel's sep line": (lambda f: "sep=;\n" + german(f, "Trial", "Time", "Force", "Depth"), []),
    "quoted decimal commas": (
        lambda f: plain(f, decimal=",", quoting=csv.QUOTE_ALL),
        [],
    ),
    "Excel's formulas": (formulas, []),
    "minus signs of a word processor": (lambda f: plain(f).replace("-", "\u2212"), []),
    "German thousands": (
        lambda f: thousands(f, ".", ",", "Versuch", "Zeit [ms]", "Kraft [N]", "Tiefe [µm]"),
        [],
    ),
    "German thousands, whole": (
        lambda f: thousands(
            f, ".", ",", "Versuch", "Zeit [ms]", "Kraft [mN]", "Tiefe [µm]", digits=0
        ),
        [],
    ),
    "English thousands": (
        lambda f: thousands(f, ",", ".", "Trial", "Time (ms)", "Load (N)", "Depth (um)"),
        [],
    ),
    "Swiss thousands": (
        lambda f: thousands(f, "'", ".", "Trial", "Time (ms)", "Load (N)", "Depth (um)"),
        [],
    ),
    "French thousands": (
        lambda f: thousands(f, "\u202f", ",", "Essai", "Temps (ms)", "Force", "Profondeur (µm)"),
        [],
    ),
    "three decimals, trimmed": (
        lambda f: plain(f.map(lambda v: f"{v:.3f}".rstrip("0").rstrip(".") or "0"), sep=";"),
        [],
    ),
    "aligned by spaces": (aligned, []),
    "numpy": (numpy_header, []),
    "half past noon": (lambda f: plain(stamped(f, "%m/%d/%Y %I:%M:%S.%f %p")), []),
    "a header again for each press": (
        lambda f: blocks(f, "Time [s],Fz [N],Depth [mm]\n"),
        [],
    ),
    "a title, a header and units for each press": (titled_blocks, []),
    "blank lines between presses": (lambda f: blocks(f, "Time,Force,Depth\n", "\n"), []),
    "pauses between presses": (lambda f: plain(f).replace("Trial", "Row"), []),
    "a clock that starts again": (
        lambda f: some(
            f.assign(t=f["t"] - f.groupby("trial")["t"].transform("min")),
            t="time",
            F="force",
            d="depth",
        ),
        [],
    ),
    "a number on a press's first row": (
        lambda f: plain(f.assign(trial=f["trial"].astype(str).where(~f["trial"].duplicated(), ""))),
        [],
    ),
    "numbers and names": (
        lambda f: plain(f.assign(trial=f["trial"].map(lambda k: f"{k}b" if k > 5 else str(k)))),
        [],
    ),
    "pictures' names": (
        lambda f: plain(f.assign(trial=f["trial"].map(lambda k: f"gel_{k:03d}.png"))),
        [],
    ),
    "dashes for no value": (lambda f: holes(f, "--"), []),
    "Excel's errors": (lambda f: holes(f, "#N/A"), []),
    "no number in Windows": (lambda f: holes(f, "-1.#IND"), []),
    "a summary below": (with_summary, []),
    "readings of -999 and 9999 N": (spikes, []),
    "a stage in the air": (lambda f: plain(f.assign(d=f["d"].where(f["d"] > 0, -2.0))), []),
    "no clock": (lambda f: some(f, trial="Trial", F="Force", d="Depth"), []),
    "rows sorted backwards": (lambda f: plain(f.iloc[::-1]), []),
    "rows shuffled": (lambda f: plain(f.sample(frac=1.0, random_state=2)), []),
    "both signs turned": (lambda f: plain(f.assign(F=-f["F"], d=-f["d"])), ["force", "depth"]),
}


def written(folder: Path, text: str | bytes) -> Path:
    path = folder / "lab.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


@pytest.mark.parametrize("case", READ)
def test_what_a_laboratory_writes_is_read_as_it_was_measured(tmp_path, case):
    make, flip = READ[case]
    frame = presses()
    path = written(tmp_path, make(frame))
    chosen = LogFormat.of_options([], flip)
    log = read_press_log(path, chosen, radius_mm=RADIUS_MM)
    assert len(log.trials) == N_PRESSES
    lost = len(frame) - len(log)
    assert lost <= 10
    assert bool(lost) == any("are dropped" in text or "is dropped" in text for text in log.warnings)
    loaded = log["force_normal_n"] > 0.2 * log["force_normal_n"].max()
    ratio = log["volume_mm3"][loaded] / log["force_normal_n"][loaded]
    # A median of some 200 samples with 4 mN of noise in 0.3 N and more.
    assert np.median(ratio) == pytest.approx(K_N, rel=0.01)
    order = np.lexsort((log["time_s"], log["trial"]))
    expected = frame["t"].to_numpy()
    if not lost and case not in ("a clock that starts again", "no clock"):
        found = log["time_s"][order]
        np.testing.assert_allclose(found - found.min(), expected, atol=2e-3)


@pytest.mark.parametrize("case", ["German headers", "no clock", "blank lines between presses"])
def test_both_commands_read_one_log(tmp_path, case):
    path = written(tmp_path, READ[case][0](presses()))
    found = calibrate_contact(LogSource(path, radius_mm=RADIUS_MM), tmp_path / "law.yaml")
    k_n = found.law.k_n_mm3_per_n
    assert abs(k_n.value - K_N) < max(3 * k_n.stderr, 0.01 * K_N)
    log = LogSource(path, radius_mm=RADIUS_MM).read(tmp_path / "unused.csv")
    assert len(log) == len(presses())


VOLUMES = ("Trial", "Time", "Force", "Volume")
REFUSED: dict[str, tuple[Callable[[pd.DataFrame], str | bytes], str]] = {
    "mN": (lambda f: with_volume(in_units(f, 1e3), *VOLUMES), "--force-unit mn (millinewtons: 5"),
    "mN, by depth": (lambda f: plain(in_units(f, 1e3)), "--force-unit mn (millinewtons: 5 mm³/N)"),
    "kN": (lambda f: plain(in_units(f, 1e-3)), '"Force [kN]" (kilonewtons: 5 mm³/N)'),
    "grams": (lambda f: plain(in_units(f, 102)), "--force-unit gf (grams: 5 mm³/N)"),
    "cm": (lambda f: plain(in_units(f, 1.0, 0.1)), '--column depth_mm="Depth [cm]"'),
    "m": (lambda f: plain(in_units(f, 1.0, 1e-3)), '--column depth_mm="Depth [m]"'),
    "m³": (
        lambda f: with_volume(f.assign(V=f["V"] * 1e-9), *VOLUMES),
        '--column volume_mm3="Volume [m3]" (m3: 5 mm³/N)',
    ),
    "px³": (lambda f: with_volume(f.assign(V=f["V"] / 0.0634**3), *VOLUMES), "gels have 0.3 to 60"),
    "a gel of water": (lambda f: with_volume(in_units(f, 0.05), *VOLUMES), "--force-unit n"),
    "ns": (lambda f: plain(in_units(f, time=1e9)), '--column time_s="Time [ns]"'),
    "ms since 1970": (lambda f: plain(f.assign(t=f["t"] * 1e3 + 1.77e12)), '"Time [ms]"'),
    "days": (lambda f: plain(f.assign(t=46000.0 + f["t"] / 86400.0)), '--column time_s="Time [d]"'),
    "a stage's position": (lambda f: plain(f.assign(d=57.3 - f["d"])), "count it from the gel's"),
    "a ball of 0.004 mm": (
        lambda f: plain(f).replace("Trial", "radius_mm", 1).replace("\n1,", "\n0.004,"),
        "more than the ball's diameter of",
    ),
    "blank lines": (
        lambda f: blocks(f.assign(d=f["V"]), "Time,Force,Volume\n", "\n"),
        '--column trial="blank lines"',
    ),
    "pauses": (
        lambda f: some(f, t="Time", F="Force", V="Volume"),
        '--column trial="pauses"',
    ),
    "no header": (lambda f: plain(f, header=False).split("\n", 1)[1], "write the columns' names"),
    "a workbook": (lambda _: b"PK\x03\x04" + bytes(200), "save its sheet as CSV"),
    "one sign turned": (lambda f: plain(f.assign(F=-f["F"])), "--flip force"),
    "two decimal marks": (
        lambda f: plain(f.assign(F=f["F"].astype(str).str.replace(".", ",")), sep=";"),
        "use a decimal point",
    ),
    "only forces": (
        lambda f: some(f, trial="Trial", t="Time", F="Force"),
        "'volume_mm3' or 'depth_mm' is missing",
    ),
    "most is empty": (
        lambda f: plain(f.assign(F=f["F"].where(f.index % 5 == 0))),
        "no usable press remains",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_right_is_refused_with_the_option_that_mends_it(tmp_path, case):
    make, words = REFUSED[case]
    path = written(tmp_path, make(presses()))
    source = LogSource(path, radius_mm=None if case == "a ball of 0.004 mm" else RADIUS_MM)
    for read in (
        lambda: calibrate_contact(source, tmp_path / "law.yaml"),
        lambda: source.read(tmp_path / "unused.csv"),
    ):
        with pytest.raises(PressError) as caught:
            read()
        assert words in str(caught.value)
    assert not (tmp_path / "law.yaml").exists()


@pytest.mark.parametrize(
    ("case", "columns", "force_unit"),
    [
        ("mN", [], "mn"),
        ("mN, by depth", [], "mn"),
        ("kN", ["force_normal_n=Force [kN]"], None),
        ("cm", ["depth_mm=Depth [cm]"], None),
        ("m", ["depth_mm=Depth [m]"], None),
        ("m³", ["volume_mm3=Volume [m3]"], None),
        ("ns", ["time_s=Time [ns]"], None),
        ("days", ["time_s=Time [d]"], None),
        ("blank lines", ["trial=blank lines"], None),
        ("pauses", ["trial=pauses"], None),
    ],
)
def test_the_option_that_is_named_mends_it(tmp_path, case, columns, force_unit):
    path = written(tmp_path, REFUSED[case][0](presses()))
    chosen = LogFormat.of_options(columns, [], force_unit)
    source = LogSource(path, chosen, RADIUS_MM)
    found = calibrate_contact(source, tmp_path / "law.yaml").law.k_n_mm3_per_n
    assert abs(found.value - K_N) < max(3 * found.stderr, 0.01 * K_N)


def test_a_gel_that_is_soft_indeed_is_read_where_newtons_are_confirmed(tmp_path):
    path = written(tmp_path, REFUSED["a gel of water"][0](presses()))
    chosen = LogFormat.of_options([], [], "n")
    law = calibrate_contact(LogSource(path, chosen), tmp_path / "law.yaml").law
    assert law.k_n_mm3_per_n.value == pytest.approx(20 * K_N, rel=0.01)


@pytest.mark.parametrize(
    ("factor", "words"),
    [(1 / STANDARD_GRAVITY, "--force-unit kgf (kg: 5"), (25.0, "gels 0.3 to 60")],
)
def test_a_gel_unlike_the_published_is_asked_about(tmp_path, factor, words):
    log = read_press_log(written(tmp_path, with_volume(in_units(presses(), factor), *VOLUMES)))
    assert any(words in text and "another gel, or another unit?" in text for text in log.warnings)


def test_the_diameter_of_a_ball_is_no_radius(tmp_path):
    text = named(presses(), "Trial", "Time", "Force", "Depth").assign(**{"Ball diameter [mm]": 8.0})
    log = read_press_log(written(tmp_path, text.to_csv(index=False)))
    assert (log["radius_mm"] == RADIUS_MM).all()


@pytest.mark.slow
def test_no_page_runs_what_a_log_is_named(tmp_path):
    """Names of files, columns and indenters are text on the pages of both commands."""
    names = {1: "<script>alert(1)</script>", 0: "b&b"}
    frame = presses().assign(indenter=lambda f: (f["trial"] % 2).map(names))
    frame["<img src=x onerror=alert(2)>"] = 1.5 * frame["trial"]
    headers = {"t": "time_s", "F": "force_normal_n", "V": "volume_mm3"}
    path = tmp_path / "<b>log.csv"
    frame.rename(columns=headers).drop(columns="d").to_csv(path, index=False)
    calibrate_contact(LogSource(path), tmp_path / "law.yaml", tmp_path / "report")
    diagnose_log(LogSource(path), tmp_path / "diagnosis")
    for page in ("report/index.html", "diagnosis/report.html"):
        text = (tmp_path / page).read_text(encoding="utf-8")
        assert not [word for word in ("<script>alert", "<img src=x", "<b>log") if word in text]
    assert "onerror=alert(2)&gt;" in text
