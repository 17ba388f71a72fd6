"""``python -m tacgen.loop.trust``."""

from tacgen.loop.trust.run import main

main()
