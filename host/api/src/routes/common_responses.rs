//! Responses that the checks in front of the routes and the extractors of their parameters give, in the OpenAPI description.

use axum::http::Method;
use utoipa::openapi::{Content, OpenApi, Ref, RefOr, Response, ResponseBuilder};

use crate::access::guard::required_role;

/// Adds them to each operation, where it describes none of its own.
pub(super) fn add(openapi: &mut OpenApi) {
    for (path, item) in openapi.paths.paths.iter_mut() {
        for (method, operation) in [
            (Method::GET, &mut item.get),
            (Method::PUT, &mut item.put),
            (Method::POST, &mut item.post),
            (Method::DELETE, &mut item.delete),
        ] {
            let Some(operation) = operation else { continue };
            let mut common = vec![
                ("403", "Not with this role, or from another site's page"),
                ("421", "This machine has no such name"),
                ("500", "The daemon failed; its log says why"),
                ("504", "Not done in time"),
            ];
            if required_role(&method, path).is_some() {
                common.push(("401", "A token is needed"));
            }
            if path.contains('{') {
                common.push(("400", "The path is not valid"));
            }
            if operation.request_body.is_some() {
                common.extend([
                    ("400", "The body is no JSON, or a header is missing"),
                    ("413", "The body is too large"),
                    ("415", "The body is not declared as JSON"),
                    ("422", "The body lacks a field, or one is not valid"),
                ]);
            }
            for (status, text) in common {
                let responses = &mut operation.responses.responses;
                responses
                    .entry(status.to_owned())
                    .or_insert_with(|| problem(text));
            }
        }
    }
}

fn problem(description: &str) -> RefOr<Response> {
    let content = Content::new(Some(Ref::from_schema_name("Problem")));
    let response = ResponseBuilder::new()
        .description(description)
        .content("application/json", content);
    RefOr::T(response.build())
}
