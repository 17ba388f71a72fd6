"""Python searches for unreachable objects seldom, and not as it ends.

A fifth of the time of imports goes into that search, and 0.3 s at the end of a command. Imported
first by the command line and by the process that workers are copied from.
"""

import atexit
import gc

gc.set_threshold(10_000)  # new objects between searches; Python's own is 700
atexit.register(gc.freeze)
