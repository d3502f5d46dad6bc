"""The memories of machines under tables of macros with and without a price that depends on size."""
