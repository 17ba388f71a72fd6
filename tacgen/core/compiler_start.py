"""Starts numba, which takes 0.3 s: imported by the process that workers are copied from."""

from numba import njit

njit()(lambda: None)()
