"""The gel's sideways motion beside finite elements."""
