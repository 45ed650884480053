"""``palanquin paper``: every experiment of section VI through the real system, claims beside measurements."""
