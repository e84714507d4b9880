"""The AnimPho method (Wei and Deng, "A Practical Model for Live Speech-Driven Lip-Sync").

Modules: the units (data), their selection, their blending, and the synthesiser that joins these.
"""
