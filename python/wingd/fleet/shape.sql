-- Deflections at fixed fractions of the span, with standard deviations from the factors of the table `shape`: an error that frames
-- share stays in their mean, others are reduced. Only equal arc lengths of one side are compared: a type whose models have different
-- lengths has a line for each.
CREATE TABLE shapes AS
SELECT solve, aircraft, coalesce(aircraft_type, 'unknown') AS aircraft_type, wing, CASE WHEN wing IN ('left', 'right') THEN wing ELSE coalesce(side, wing) END AS side, recorder_id, flight, series, shot,
       eta, round(arc_length_m, 3) AS arc_length_m, length_m, deflection_m, sigma_own_m, lasting_key, factor_lasting_m, shared_key, factor_shared_m,
       weight_kg * load_factor / 1000 AS load_t,
       -- Flights count equally, and so do the frames of each.
       1 / count(*) OVER (PARTITION BY solve, recorder_id, flight, wing, eta) AS of_flight
FROM shape WHERE status = 'ok' AND deflection_m IS NOT NULL;

CREATE VIEW shape_by_flight AS
WITH sources AS (
    SELECT solve, recorder_id, flight, wing, eta, 'lasting' AS kind, lasting_key AS key, unnest(factor_lasting_m) * of_flight AS part,
           generate_subscripts(factor_lasting_m, 1) AS source FROM shapes
    UNION ALL
    SELECT solve, recorder_id, flight, wing, eta, 'shared', shared_key, unnest(factor_shared_m) * of_flight,
           generate_subscripts(factor_shared_m, 1) FROM shapes),
summed AS (SELECT solve, recorder_id, flight, wing, eta, kind, key, source, sum(part) AS part FROM sources GROUP BY ALL),
common AS (SELECT solve, recorder_id, flight, wing, eta, sum(part ** 2) AS variance FROM summed GROUP BY ALL),
means AS (
    SELECT solve, aircraft, aircraft_type, wing, side, recorder_id, flight, eta, arc_length_m, any_value(length_m) AS length_m,
           count(*) AS frames, avg(deflection_m) AS deflection_m, stddev_samp(deflection_m) AS scatter_m, avg(load_t) AS load_t,
           sum((sigma_own_m * of_flight) ** 2) AS own FROM shapes GROUP BY ALL)
SELECT means.* EXCLUDE own, sqrt(coalesce(variance, 0) + own) AS sigma_m
FROM means LEFT JOIN common USING (solve, recorder_id, flight, wing, eta);

-- Mean shape of a wing over its flights. Loads are those of the flights: aircraft are compared at equal loads by aircraft_against_type.
CREATE VIEW shape_by_wing AS
WITH weighted AS (
    SELECT *, of_flight / all_flights AS weight FROM (
        SELECT *, max(rank) OVER (PARTITION BY solve, aircraft, wing, eta, arc_length_m) AS all_flights FROM (
            SELECT *, dense_rank() OVER (PARTITION BY solve, aircraft, wing, eta, arc_length_m ORDER BY recorder_id, flight) AS rank FROM shapes))),
sources AS (
    SELECT solve, aircraft, wing, eta, arc_length_m, 'lasting' AS kind, lasting_key AS key, unnest(factor_lasting_m) * weight AS part,
           generate_subscripts(factor_lasting_m, 1) AS source FROM weighted
    UNION ALL
    SELECT solve, aircraft, wing, eta, arc_length_m, 'shared', shared_key, unnest(factor_shared_m) * weight,
           generate_subscripts(factor_shared_m, 1) FROM weighted),
summed AS (SELECT solve, aircraft, wing, eta, arc_length_m, kind, key, source, sum(part) AS part FROM sources GROUP BY ALL),
common AS (SELECT solve, aircraft, wing, eta, arc_length_m, sum(part ** 2) AS variance FROM summed GROUP BY ALL),
means AS (
    SELECT solve, aircraft, any_value(aircraft_type) AS aircraft_type, wing, any_value(side) AS side, eta, arc_length_m,
           any_value(length_m) AS length_m, max(all_flights) AS flights, count(*) AS frames, sum(deflection_m * weight) AS deflection_m,
           avg(load_t) AS load_t, sum((sigma_own_m * weight) ** 2) AS own FROM weighted GROUP BY solve, aircraft, wing, eta, arc_length_m)
SELECT means.* EXCLUDE own, sqrt(coalesce(variance, 0) + own) AS sigma_m
FROM means LEFT JOIN common USING (solve, aircraft, wing, eta, arc_length_m);

-- Deflection = a + b load at a place of the span, by type and side: the line with which an aircraft is compared; null if all loads
-- are equal.
CREATE VIEW line_of_type AS
SELECT solve, aircraft_type, side, eta, arc_length_m, count(*) AS frames,
       CASE WHEN min(load_t) < max(load_t) THEN regr_slope(deflection_m, load_t) END AS slope_m_per_t,
       CASE WHEN min(load_t) < max(load_t) THEN regr_intercept(deflection_m, load_t) END AS intercept_m,
       CASE WHEN min(load_t) < max(load_t)
            THEN sqrt(regr_syy(deflection_m, load_t) * (1 - regr_r2(deflection_m, load_t)) / nullif(count(*) - 2, 0)) END AS scatter_m,
       min(load_t) AS least_t, max(load_t) AS most_t
FROM shapes WHERE load_t IS NOT NULL
GROUP BY ALL;

-- Offset of a wing from the line of its type and side. Its standard deviation is that of the mean shape, which has all errors common
-- to the flights, and the scatter of flights beside it, which has what the standard deviation does not know (null for one flight).
CREATE VIEW aircraft_against_type AS
WITH residuals AS (
    SELECT solve, aircraft, aircraft_type, wing, side, recorder_id, flight, eta, arc_length_m,
           avg(deflection_m - intercept_m - slope_m_per_t * load_t) AS residual_m
    FROM shapes JOIN line_of_type USING (solve, aircraft_type, side, eta, arc_length_m)
    WHERE load_t IS NOT NULL GROUP BY ALL),
means AS (
    SELECT solve, aircraft, aircraft_type, wing, side, eta, arc_length_m, count(*) AS flights, avg(residual_m) AS offset_m,
           stddev_samp(residual_m) / sqrt(count(*)) AS scatter_of_mean_m
    FROM residuals GROUP BY ALL)
SELECT means.*, sigma_m, offset_m / sqrt(coalesce(scatter_of_mean_m, 0) ** 2 + sigma_m ** 2) AS over_sigma
FROM means JOIN (SELECT solve, aircraft, wing, eta, arc_length_m, sigma_m FROM shape_by_wing) USING (solve, aircraft, wing, eta, arc_length_m);
