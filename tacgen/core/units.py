"""Conversions between tacgen's units (N, mm, s, rad, °C, kg) and others, and known constants."""

MM_PER_M = 1000.0
M_PER_MM = 1e-3
STANDARD_GRAVITY_M_S2 = 9.80665
"""CODATA standard gravity; also the factor that turns a gauge reading in kgf into newtons."""
PUBLISHED_K_N_MM3_PER_N = 5.135  # taxim-robot's slope of 200 039 px³/N at its 0.0295 mm/px
