"""The local web page for the person in the tank hall: pick the datum, watch the track, read the result.

State and logic stand in plain modules. Those whose names begin with ``page`` draw them and stand on NiceGUI; only ``server.serve``
imports them.
"""
