"""The AnimPho method (Wei and Deng, "A Practical Model for Live Speech-Driven Lip-Sync").

Units (data), selection, blending, and the synthesiser that joins them.
"""
