"""``python -m tacgen``."""

from tacgen.cli import main

main()
