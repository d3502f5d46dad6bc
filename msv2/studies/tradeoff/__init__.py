"""What accuracy costs in time: settings of machine, simulation and training swept, drawn, and chosen from."""
