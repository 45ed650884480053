"""``palanquin bench``: what the system costs, beside what it is built on, in a form that commits can be compared by."""
