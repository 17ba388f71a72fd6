"""The gel's sideways motion beside a finite-element model; see docs/results/shear.md."""
