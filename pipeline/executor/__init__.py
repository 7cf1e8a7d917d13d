"""Work side by side: over processes of their own (``processes``), or in a forked copy of this one (``copies``)."""
