-- All markers, read once, by aircraft and by the reason why a marker was not used; numbers in reasons are replaced so that
-- equal reasons are grouped.
CREATE TABLE marks AS
SELECT solve, aircraft, wing, recorder_id, used,
       CASE WHEN NOT used THEN regexp_replace(marker_reason, '[0-9]+([.][0-9]+)?', '#', 'g') END AS reason,
       count(*) AS markers, median(greatest(sigma_u_px, sigma_v_px)) AS sigma_px,
       sum(residual_u_px ** 2 + residual_v_px ** 2) AS squares, count(residual_u_px) AS residuals,
       count(*) FILTER (abs(w_test) > 3.29) AS beyond
FROM markers WHERE marker IS NOT NULL GROUP BY ALL;

CREATE VIEW detection AS
WITH f AS (SELECT solve, aircraft, wing, recorder_id, count(image) AS frames FROM frames GROUP BY ALL)
SELECT solve, aircraft, wing, recorder_id, any_value(frames) AS frames, sum(markers) AS markers,
       coalesce(sum(markers) FILTER (used), 0) / sum(markers) AS used_share, any_value(sigma_px) FILTER (used) AS sigma_px,
       sqrt(sum(squares) FILTER (used) / sum(residuals) FILTER (used)) AS residual_px,
       sum(beyond) FILTER (used) / sum(markers) FILTER (used) AS beyond_share
FROM marks JOIN f USING (solve, aircraft, wing, recorder_id) GROUP BY ALL;

CREATE VIEW marker_reasons AS
SELECT solve, aircraft, reason, sum(markers) AS markers FROM marks WHERE reason IS NOT NULL GROUP BY ALL;
