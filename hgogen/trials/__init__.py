"""What a trial shows: metrics, figures, comparisons with a reference and a record, Gramians, the response to noise."""
