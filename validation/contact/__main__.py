"""``python -m validation.contact``."""

from validation.contact.run import main

main()
