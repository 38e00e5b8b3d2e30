"""Sessions in a browser: a server of replays and reports, each a process of its own."""
