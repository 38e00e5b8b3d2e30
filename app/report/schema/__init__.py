"""Results as JSON documents for other programs: one class a document, one field a key.

A field says its type and where its value stands in the frozen results; nothing is computed that
they do not hold. ``docs/schemas`` is generated from here. May import everything but screens.
"""
