"""Known ways in which splatting software fails, as one registry of cases that run on every renderer of the project.

    makers                  small models and cameras
    case                    the definition of a case
    projection ... streams  the cases by subject; `registry` lists those that renderers run, `streams` those of the machine
    alone check                   runs the cases on the oracle and on the integer renderer gradients               runs them on
    the differentiable renderer rtl                     runs them on the machine golden_faults           removes guards from the
    renderers, to show that cases notice; `rtl_faults` does so in the hardware command, report         the command line and its
    reports
"""
