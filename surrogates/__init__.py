"""Backends beside the reference, fast or learned.

``miniature`` (coarse physics with an upscaler on top), ``upscale`` (the upscalers), ``cell`` (the physics-embedded
CNN), ``checkpoint`` (weights with their cards, in ``weights``). The registry of ``cloth_envs`` names them and imports
them on use; they need no torch but for the cell's engine ``"torch"``.
"""
