"""A person who leads: what a keyboard or a gamepad means, and the process that reads it."""
