"""The machines as commands ask them: one file each, its options, results, texts and documents.

A command finds its machine in `registry` and knows none by name. May import every room of `app`
but commands; what is heavy, only inside functions, so that one machine loads nothing of another.
"""
