"""Judge of recordings: spectra of recorded textures beside those of the library. Read `measure.py` first."""
