"""Fit F_Θ with torch to recordings of one material; the shipped weights come from simulated strokes on many materials.

Recordings become spectra of short windows (`windows`), and the expected spectra of the field are fitted to them by
maximum likelihood (`fit`). Read `from_recordings.train_from_recordings` first. The shared field is trained in a source
checkout alone (tools/hnf_lab/shared_field). `train_map` trains the map predictor D_φ.
"""
