from planview.sweep.results import JobResult, summary_csv
from planview.sweep.study import Configuration


def test_summary_has_a_row_per_run_and_a_column_per_parameter() -> None:
    done = JobResult("hall", Configuration(("a.b=1", "c.d=true")), 3, figures={"mota": 0.5})
    header, row = summary_csv([done]).splitlines()
    assert header.startswith("recording,a.b,c.d,seed,state,tracked_from,mota,idf1")
    assert row.startswith("hall,1,true,3,done,recording,0.5,,")


def test_summary_keeps_spreadsheets_from_taking_names_for_formulas() -> None:
    failed = JobResult('=HYPERLINK("x")', Configuration(("a.b=-1",)), 0, error="no floor")
    row = summary_csv([failed]).splitlines()[1]
    assert row.startswith('"\'=HYPERLINK(""x"")",-1,0,failed') and row.endswith(",no floor")
