"""Compiled time loops behind an interface of plain arrays: no physics, only stencils, laws and addresses.

- The loop: `engine` (the interface), `field` (its tables to begin with), `settings` (features that are set later),
`operations` (what a step consists of), `tables` (what kernels read), `loop` (which calls them), `repeats`, `threads`. -
Functions that do the operations: `program`, `sweep_program` (the box part by part), `layer_program`; `rows` has the
code of single rows and tiles. - Values: `layout` (levels in memory), `state` (what a checkpoint holds), `exchange`
(halos from other processes). - Absorbing layers: `layers` (the method, and its tables), `layer_tables` (which builds
them), `layer_passes` (passes to which only layers add), `filter` and `dampers` (short and backward waves), `stretches`
(of derivatives). - Other sides: `ends` (exact ends of a bar), `outline_stencil`, `chain_loops`. - The medium: `media`
(that vary), `surface` and `absent` (missing bonds and nodes), `phases` (solid and liquid), `drag`, `thermal_strain`. -
Bonds with a law of their own: `bonds`, `bond_zone`. - State-based media: `passes`, `point_law`, `shape_tensors`,
`damage`, `release`.
"""
