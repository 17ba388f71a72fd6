"""The loop on press images: what a calibrated look-up table leaves over, and its cause."""
