"""Export of speech for screen avatars: cartoon mouth shapes, ARKit blendshapes, OVR visemes.

Pure functions of phonemes and frames; times are sound times.
"""
