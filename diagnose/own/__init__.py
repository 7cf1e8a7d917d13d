"""A model of one's own: equations in a Python file or an FMU, records as tables; what it misses, and the corrected model back."""

from .model import Input, Missing, Model, Number, Output, State

__all__ = ["Input", "Missing", "Model", "Number", "Output", "State"]
