"""Formal proofs of the machine's units: claims that hold for all inputs and for ever, or up to a stated number of cycles.

`bench` surrounds a component by its signature, `contract` has the claims that hold of any component with streams, `units` says
what is proven of which component, `registry` lists them all, and `circuit` and `engine` ask Yosys and ABC. docs/formal.md
tells how to prove a claim of a unit of one's own; `msv2 study run formal` proves everything.
"""
