"""The laws in plain NumPy: the definition of every force and contact, and the oracle of the compiled kernels.

``sheet`` (springs, dashpots, bending, weight), ``air`` (wind, pressure), ``bodies`` (contact), ``step`` (what is
driven, and a frame of them all), ``particles`` (the net of Zhao 2024); ``stencil``, ``diagnostics`` and
``budget`` beside them. All is computed in float64, one vertex class at a time, with nothing saved or reused: read it,
do not run it on anything large.
"""
