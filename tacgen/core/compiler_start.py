"""Starts numba, which takes 0.3 s: imported last by the process that workers are copied from."""

import gc

from tacgen.core.compiled import njit

njit()(lambda: None)()
gc.freeze()  # what is imported stays: no worker searches it for unreachable objects
