"""Sound input and output: files, microphones, loudspeakers, silence, and the timeline of speech.

Every source returns `AudioBlock`s whose times are counted in samples; nothing here knows words.
"""
