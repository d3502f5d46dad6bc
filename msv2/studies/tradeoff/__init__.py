"""The cost of accuracy in time: sweeps over settings of machine, simulation and training, with plots and recommendations."""
