"""The few conversions between tacgen's units (N, mm, s, rad, °C, kg) and the outside world's."""

MM_PER_M = 1000.0
M_PER_MM = 1e-3
STANDARD_GRAVITY_M_S2 = 9.80665
"""CODATA standard gravity; also the factor that turns a gauge reading in kgf into newtons."""
