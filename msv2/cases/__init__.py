"""Known ways in which splatting software fails, as one registry of cases, run on every renderer of the project.

`makers` makes small models and cameras, `case` says what a case is, `projection` .. `streams` hold the cases by subject,
`registry` lists them, `check` runs them on the oracle and on the integer renderer, `faults` drops guards to see that cases
notice, `ranges` profiles the values that records take. The gradient's part is `msv2.cases.gradients`, the
RTL's is `msv2.cases`, which also has the command line.
"""
