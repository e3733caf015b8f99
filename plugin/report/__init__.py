"""The report that people look at: its assembly, the HTML page and the terminal's lines.

``build`` assembles ``report.json``; ``view`` makes it ready to be shown;
``story`` (the verdict), ``checks`` (what an alignment proved), ``candidates``,
``flights`` and ``bands`` put it into words and tables; ``charts``,
``distributions`` and ``survey_map`` draw; ``html`` and ``terminal`` set it.
"""
