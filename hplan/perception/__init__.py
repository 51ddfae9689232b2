"""Frames of a depth camera: cropped to reach, thinned, without the arm and what is known, remembered where hidden."""
