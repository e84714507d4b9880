"""Where sound comes from: files, microphones, silence.

Every source hands out `AudioBlock`s whose times are counted in samples; nothing here knows words.
"""
