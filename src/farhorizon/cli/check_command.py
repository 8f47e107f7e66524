"""`farhorizon check`."""

from __future__ import annotations

import argparse
import time
import warnings

from farhorizon.cli.common import BAD_INPUT, GOOD, case_of, check_folder, made_folder, write_json


def check_command(options: argparse.Namespace) -> int:
    from farhorizon.case.preview import draw_geometry, whole_time
    from farhorizon.engine.codegen.compile_notice import compile_seconds
    from farhorizon.errors import ValidityWarning
    from farhorizon.pictures.style import counted_in
    from farhorizon.simulation.setup.regions import regions_of

    begin = time.perf_counter() - compile_seconds()  # compiled earlier in this process
    if options.out:
        check_folder(options.out)
    case = case_of(options)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ValidityWarning)  # the report contains them
        sim = case.run()
    with case.naming():
        sim.prepare(case.end)
        probes = sim.record(case.parts.output.probes, case.parts.output.probe_every)
    start = time.perf_counter() - begin - compile_seconds()
    with counted_in(case.unit_names):
        report = sim.check(case.end, options.budget)
    if regions := regions_of(sim, case.materials):
        report.rows.append(("materials", str(regions)))
    whole_time(case, sim, report, start)
    report.rows.append(("outputs", case.schedule(sim.dt)))
    report.notes = [*report.notes, *probes.notes]
    print(report.details if options.details else report)
    if options.out:
        folder = made_folder(options.out)
        with counted_in(case.unit_names):
            pictures = [*draw_geometry(case, sim, folder), *report.draw(folder, case.name, case.lattice.spacing)]
        for picture in pictures:
            print(f"picture: {picture}")
    facts = report.as_json()
    if options.tune:
        from farhorizon.studies.tuning import BUDGET, tuned

        with case.naming():
            tuned_side = tuned(case.simulation(), budget=options.budget or BUDGET)
        print(f"tuned: {tuned_side}\nin the case file: all = {tuned_side.toml}")
        facts["tuned"] = tuned_side.as_json()
    write_json(options.json, facts)
    if report.refused:
        print("farhorizon: run refuses this case: it is not stable", file=options.errors)
        return BAD_INPUT
    if options.quiet:
        print(f"{case.name}: {report.headline}", file=options.output)
    return GOOD
