"""Arguments that functions share."""

import logging

from planview.api.arguments import log_errors_only


def test_quiet_work_logs_no_warning(caplog):
    log = logging.getLogger("planview.anything")
    with log_errors_only(quiet=True):
        log.warning("dark images")
    log.warning("light images")
    assert [record.message for record in caplog.records] == ["light images"]
