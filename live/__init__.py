"""A tow while it is filmed: sources that are heard as they come, what is said of every frame, what the tows so far have told.

What judges (``seen``, ``watch``, ``ready``) is a function of stamped frames and knows no clock of its own: tests and benchmarks
feed it films as fast as they can be read.
"""
