"""The same speech for screen avatars: mouth shapes of cartoons, ARKit blendshapes, OVR visemes.

Pure functions of phonemes and frames; times are sound times.
"""
