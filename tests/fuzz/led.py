"""Atheris on one reader: ``python -m tests.fuzz.led READER FOLDER [libFuzzer's options]``."""

from __future__ import annotations

import contextlib
import sys
from pathlib import Path

import atheris

with atheris.instrument_imports(include=["tacgen"]):
    from tacgen.errors import TacgenError
    from tests.fuzz.readers import READERS


def main(name: str, folder: Path, options: list[str]) -> None:
    """Fuzz until the options say enough; an exception that is no ``TacgenError`` ends it."""
    reader = READERS[name]
    path = reader.make(folder)
    corpus = folder / "corpus"
    corpus.mkdir()
    (corpus / "sound").write_bytes(path.read_bytes())
    with atheris.instrument_imports(include=["tacgen"]), contextlib.suppress(TacgenError):
        reader.read(path)

    def read(data: bytes) -> None:
        path.write_bytes(data)
        with contextlib.suppress(TacgenError):
            reader.read(path)

    atheris.Setup([name, *options, str(corpus)], read)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]), sys.argv[3:])
