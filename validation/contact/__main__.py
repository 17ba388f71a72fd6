"""``python -m validation.contact``."""

from __future__ import annotations

import argparse
from pathlib import Path

from threadpoolctl import threadpool_limits

from validation.contact import run
from validation.contact.page import write_page


def main() -> None:
    """Run the study and write the page."""
    parser = argparse.ArgumentParser(description=(run.__doc__ or "").splitlines()[0])
    parser.add_argument("--repeats", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("docs/results/diagnosis_contact.md"))
    parser.add_argument("--store", type=Path, default=Path("out/trust/outcomes.jsonl"))
    parser.add_argument("--kept-only", action="store_true", help="trace nothing that is not kept")
    parser.add_argument("--note", default="", help="a sentence for the page, under its table")
    arguments = parser.parse_args()
    with threadpool_limits(limits=1):
        outcomes = run.run_study(arguments.repeats, arguments.store, kept_only=arguments.kept_only)
    write_page(outcomes, arguments.out, arguments.note)


if __name__ == "__main__":
    main()
