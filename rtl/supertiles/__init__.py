"""What only machines with lists by super-tile have (`spec.supertiles`)."""
