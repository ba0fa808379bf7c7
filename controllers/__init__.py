"""Controllers: estimates in, commands out, each a pure ``init`` and ``step``."""
