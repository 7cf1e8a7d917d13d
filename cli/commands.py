"""The commands, a module each: ``NAME``, ``HELP``, ``add_arguments(sub)``, ``call(options)``.

A module parses, calls and prints; it computes nothing and imports nothing heavy before it is called.
"""

from types import ModuleType


def modules() -> tuple[ModuleType, ...]:
    """The commands' modules, in the order of ``towline --help``."""
    from . import (
        app,
        blind,
        budget,
        campaign,
        check,
        compare,
        completion,
        datum,
        diagnose,
        doctor,
        export,
        gap,
        identify,
        import_,
        init,
        lens,
        live,
        motion,
        plan,
        rectify,
        render,
        run,
        simulate,
        steady,
        track,
    )

    return (
        run,
        track,
        live,
        motion,
        identify,
        steady,
        simulate,
        render,
        init,
        app,
        campaign,
        check,
        diagnose,
        gap,
        blind,
        compare,
        budget,
        datum,
        lens,
        plan,
        rectify,
        doctor,
        completion,
        import_,
        export,
    )
