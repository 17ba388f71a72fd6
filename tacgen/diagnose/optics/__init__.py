"""Diagnosis of press images: the residuals of a calibrated look-up table, and their causes."""
