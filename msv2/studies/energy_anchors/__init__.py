"""What two libraries say of the energy of the same units at 16 nm."""
