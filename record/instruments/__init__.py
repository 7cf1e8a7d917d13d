"""Motion from a tank's instruments: tracked lamps on a bar with holes, potentiometers, an LVDT (thesis 7.4 to 7.6)."""

from .channels import Channel, read_channels
from .clock import Clock, clock_from_events, clock_from_match
from .motion import FromInstruments, motion_from_channels
from .setup import BarTable, ChannelTable, ClockTable, SetupFile, read_setup

__all__ = [
    "BarTable",
    "Channel",
    "ChannelTable",
    "Clock",
    "ClockTable",
    "FromInstruments",
    "SetupFile",
    "clock_from_events",
    "clock_from_match",
    "motion_from_channels",
    "read_channels",
    "read_setup",
]
