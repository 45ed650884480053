"""A million messages that are not what they should be, at everything that takes messages in."""
