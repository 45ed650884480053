"""Makes the documentation site from the pages of ``docs/``, the code and the command line: ``make docs``."""
