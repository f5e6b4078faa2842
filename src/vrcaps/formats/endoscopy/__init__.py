"""Formats of endoscopic data sets: SimCol3D, C3VD, EndoSLAM, EndoMapper, SC-SfMLearner."""
